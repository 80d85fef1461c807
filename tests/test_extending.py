"""The page on extending is complete: what it prints, put into files, trains as it says."""

import json
import math
import shlex
import shutil
import sys
from pathlib import Path

import pages
import pytest
import torch
from omegaconf import OmegaConf

from navrl import factory
from navrl.config import compose, instantiate
from navrl.factory.environment import make_training_env

PAGE = pages.ROOT / "docs" / "extending.md"
COMMANDS = pages.commands(PAGE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("extending")
    for name, text in pages.files(PAGE).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def here(folder, monkeypatch):
    """As in a shell in that folder, with ``PYTHONPATH=.``."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "my_package"]:
        del sys.modules[name]


def printed(chosen):
    """Return the command that makes this choice."""
    (command,) = [line for line in COMMANDS if chosen in shlex.split(line)]
    return command


def train(chosen, *more):
    """Run the printed command on a tiny training; return its folder's name."""
    run = f"outputs/train/{chosen.rpartition('=')[2]}"
    pages.run(printed(chosen), *pages.TINY_TRAINING, f"hydra.run.dir={run}", *more)
    return run


def evaluate(last_word):
    """Run the printed command on two short episodes; return its summary."""
    tiny = ["suite.num_episodes=2", "num_worlds=2", "environment.time_limit_steps=4"]
    tiny += ["progress_bar=false", "hydra.run.dir=outputs/evaluate/mine"]
    shutil.rmtree("outputs/evaluate/mine", ignore_errors=True)
    pages.run(printed(last_word), *tiny)
    return json.loads(Path("outputs/evaluate/mine/summary.json").read_text())


def finished(run):
    """Return the configuration and the last row of numbers of a training that went to its end."""
    summary = json.loads((run / "evaluation" / "summary.json").read_text())
    assert summary["episodes"] == 2 and summary["errors"] == 0
    header, *rows = (run / "metrics.csv").read_text().splitlines()
    assert rows
    return OmegaConf.load(run / "config.yaml"), header.split(",")


def first_episodes(run):
    """Return the environment of a run and its first observations."""
    cfg = OmegaConf.load(run / "config.yaml")
    env = make_training_env(cfg, seed=0)
    return env, env.reset()


def test_every_file_is_asked_for_by_a_command():
    chosen = " ".join(COMMANDS)
    texts = pages.files(PAGE)
    for name in texts:
        if name.startswith("my_conf/"):
            _, group, file = name.removesuffix(".yaml").split("/")
            by_experiment = any(f"override /{group}: {file}\n" in text for text in texts.values())
            assert f"{group}={file}" in chosen or by_experiment, name
        else:
            module = name.removesuffix(".py").replace("/", ".")
            assert any(f"{module}." in text for text in texts.values()), name


def test_own_transform(here):
    run = here / train("transforms=mast")
    cfg, _ = finished(run)
    assert next(k for k in cfg.transforms if k != "_target_") == "mast"  # in front of min_pool
    _, td = first_episodes(run)
    hidden = slice(math.ceil(700 / 8), 740 // 8)  # bins of nothing but hidden beams
    assert not td["returns"][:, hidden].any()
    assert td["returns"].any()
    assert evaluate("allow=[my_package]")["policy"] == "mast"


def test_own_world(here, capsys):
    (script,) = pages.blocks(PAGE, "python")
    exec(compile(script, "extending.md", "exec"), {"__name__": "script"})
    kind, points, people = capsys.readouterr().out.split()
    assert kind == "hall" and int(points) > 80 and int(people) >= 2
    cfg, _ = finished(here / train("experiment=hall"))
    assert cfg.suite.name == "hall"
    assert {scenario.kind for scenario in instantiate(cfg.suite).scenarios()} == {"hall"}
    assert evaluate("suite=hall")["by_scenario"].keys() == {"other"}


def test_own_robot(here):
    run = here / train("robot=cart")
    finished(run)
    env, _ = first_episodes(run)
    env.reset()
    backwards = env.action_spec.zero() - torch.tensor([1.0, 0.0])
    before = env.base_env.simulator.state().pose[:, :2].clone()
    td = env.rand_action(env.reset()).set("action", backwards)
    env.step(td)
    assert (env.base_env.simulator.state().pose[:, :2] - before).norm(dim=-1).max() > 0


def test_own_lidar(here):
    run = here / train("experiment=long_range")
    cfg, _ = finished(run)
    _, td = first_episodes(run)
    assert td["ranges"].shape[-1] == 720 and td["points"].shape[-2:] == (180, 2)
    assert 3.5 < td["ranges"].max() <= 8.0
    assert cfg.transforms.normalize.scale == cfg.transforms.tagd.max_range == 8.0


def test_own_stream(here):
    run = here / train("experiment=point_set")
    finished(run)
    env, td = first_episodes(run)
    actor, _ = factory.make_agent(
        OmegaConf.load(run / "config.yaml"), factory.observation_shapes(env)
    )
    acted = actor(td.clone())
    streams = {name.split("streams.")[-1].partition(".")[0] for name, _ in actor.named_parameters()}
    assert {"point_set", "temporal"} <= streams and "spatial" not in streams
    turned = td.clone().set("spatial", td["spatial"].flip(-2))
    assert torch.allclose(actor(turned)["action"], acted["action"], atol=1e-3)


def test_own_reward_term(here):
    run = here / train("reward=brisk")
    _, columns = finished(run)
    assert any("dawdling" in column for column in columns)
    env, _ = first_episodes(run)
    td = env.rand_action(env.reset()).set("action", env.action_spec.zero() - 1.0)  # v = 0
    terms = env.step(td)["next", "reward_terms"]
    assert terms["dawdling"].flatten().tolist() == pytest.approx([-0.05] * 2)


def test_a_mistake_in_an_own_file_is_answered_in_a_line(here, capsys):
    with pytest.raises(SystemExit, match="2"):
        pages.run(printed("robot=cart"), "+robot.wings=2", *pages.TINY_TRAINING)
    assert capsys.readouterr().err.startswith("navrl: ")


def test_compose_is_left_as_it_was():
    """Commands run in this process must leave no search path behind."""
    with pytest.raises(Exception, match="cart"):
        compose("train", ["robot=cart"])
