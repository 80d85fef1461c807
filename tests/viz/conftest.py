"""A real episode, recorded once for all pictures, and a report about it."""

import csv
import dataclasses

import numpy as np
import pytest
import torch
from browser import Chromium, find_chromium
from evaluated import HIT, LATE, WON, write_evaluation
from tensordict.nn import TensorDictSequential

from navrl.config import compose, instantiate
from navrl.evaluation.recorder import record_episode
from navrl.factory import make_env, make_navigation_env, observation_shapes
from navrl.networks import make_actor
from navrl.policies.classical import PurePursuit
from navrl.viz.report import write_report


@pytest.fixture(scope="session")
def recording():
    """Pure pursuit in an intersection, with the attention of an untrained actor."""
    cfg = compose("train", ["scenario=intersection", "network=small"])
    env = make_env(make_navigation_env(cfg, 1, privileged=True), instantiate(cfg.transforms))
    torch.manual_seed(0)
    encoder = instantiate(cfg.network.encoder)
    actor = make_actor(encoder, observation_shapes(env), with_attention=True)
    policy = TensorDictSequential(actor, PurePursuit(env.base_env.simulator.robot))
    scenario = instantiate(cfg.scenario).sample("pictured", 0, 1)
    yield record_episode(env, policy, scenario)
    env.close()


@pytest.fixture(scope="session")
def lost(recording):
    """The recorded episode as one that was lost, by a policy that hides a tag in its name."""
    steps = recording.num_steps
    reward = {"progress": np.linspace(0, 1, steps, dtype=np.float32)}
    return dataclasses.replace(recording, outcome="collision_static", reward_terms=reward)


@pytest.fixture(scope="session")
def folder(tmp_path_factory, recording, lost):
    folder = tmp_path_factory.mktemp("sweep")
    for name, policy, outcomes in (
        ("a", "paper", [WON] * 11 + [HIT]),
        ("b", "dwa", [HIT] * 8 + [WON] * 2 + [LATE] * 2),
        ("c", "</script><b>evil</b>", [WON] * 10 + [HIT] * 2),
        ("d", "oracle", [WON] * 12),
        ("e", "mine_seed_0", [HIT] * 12),
        ("f", "mine_seed_1", [HIT] * 11 + [WON]),
    ):
        columns = {} if policy == "oracle" else {"time_to_goal_s": "{time}"}
        write_evaluation(folder / name, policy, outcomes, **columns)
    with (folder / "metrics.csv").open("w", newline="") as file:
        rows = [["frames", "evaluation/success_rate"], [100, 0.25], [200, 0.5]]
        csv.writer(file).writerows(rows)
    (folder / "played").mkdir()
    dataclasses.replace(recording, outcome="success").save(folder / "played" / "won.npz")
    lost.save(folder / "played" / "lost.npz")
    return folder


@pytest.fixture(scope="session")
def page(folder):
    pytest.importorskip("plotly", reason="needs the extra report")
    return write_report([folder], folder / "deep" / "report.html")


@pytest.fixture(scope="session")
def chromium(tmp_path_factory):
    if find_chromium() is None:
        pytest.skip("no chromium here: apt-get install chromium")
    browser = Chromium(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()
