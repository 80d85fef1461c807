"""The page on extending is complete: what it prints, put into files, trains as it says."""

import importlib
import json
import math
import shlex
import shutil
import sys
from contextlib import nullcontext
from pathlib import Path
from unittest import mock

import gymnasium
import matplotlib.image
import pages
import pytest
import torch
from omegaconf import OmegaConf

from navrl import factory
from navrl.config import compose, instantiate
from navrl.deploy import PolicyRunner
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
    """Run the printed command on a tiny training; return its folder's name.

    Only what changes the scene draws the training's pictures.
    """
    run = f"outputs/train/{chosen.rpartition('=')[2]}"
    is_seen = chosen.startswith(("experiment=hall", "experiment=long_range", "robot=", "scenario="))
    with nullcontext() if is_seen else pages.undrawn():
        pages.run(printed(chosen), *pages.TINY_TRAINING, f"hydra.run.dir={run}", *more)
    return run


TINY_EVALUATION = (
    *("suite.num_episodes=2", "num_worlds=2", "environment.time_limit_steps=4"),
    *("progress_bar=false", "hydra.run.dir=outputs/evaluate/mine"),
)


def evaluate(last_word):
    """Run the printed command on two short episodes; return its summary."""
    shutil.rmtree("outputs/evaluate/mine", ignore_errors=True)
    pages.run(printed(last_word), *TINY_EVALUATION)
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


def test_every_documented_file_is_used_by_a_command():
    chosen = " ".join(COMMANDS)
    texts = pages.files(PAGE)
    for name in texts:
        if name.startswith("my_conf/"):
            _, group, file = name.removesuffix(".yaml").split("/")
            by_experiment = any(f"override /{group}: {file}\n" in text for text in texts.values())
            key = "policy" if group == "controller" else group
            assert f"{key}={file}" in chosen or by_experiment, name
        else:
            module = name.removesuffix(".py").replace("/", ".")
            assert any(f"{module}." in text for text in (*texts.values(), chosen)), name


@pytest.mark.slow
def test_own_transform(here):
    run = here / train("transforms=mast")
    cfg, _ = finished(run)
    assert next(k for k in cfg.transforms if k != "_target_") == "mast"  # in front of min_pool
    _, td = first_episodes(run)
    hidden = slice(math.ceil(700 / 8), 740 // 8)  # bins of nothing but hidden beams
    assert not td["returns"][:, hidden].any()
    assert td["returns"].any()
    assert evaluate("policy=outputs/train/mast")["policy"] == "mast"


@pytest.mark.slow
def test_own_pooling(here):
    run = here / train("transforms=median")
    finished(run)
    _, td = first_episodes(run)
    beams = td["ranges"].unflatten(-1, (180, 8))
    torch.testing.assert_close(td["ranges_pooled"], beams.median(-1).values)


@pytest.mark.slow
def test_own_world_from_a_map(here):
    (script,) = [text for text in pages.blocks(PAGE, "python") if "plan.png" in text]
    exec(compile(script, "plan", "exec"), {})
    cfg, _ = finished(here / train("scenario=plan"))
    scenario = instantiate(cfg.scenario).sample("mine", seed=0, index=0)
    occupied = matplotlib.image.imread("plan.png")[..., 0] < 0.5
    assert scenario.kind == "floor_plan" and len(scenario.boxes) == occupied.sum()
    assert occupied.sum() == 88


@pytest.mark.slow
def test_own_logger(here, capsys):
    run = here / train("logger=lines")
    finished(run)
    assert "frames: 0% success" in capsys.readouterr().out
    assert (run / "lines/scalars/evaluation/success_rate.csv").is_file()
    assert not (run / "tensorboard").exists()


@pytest.mark.slow
def test_own_collector(here):
    run = here / train("collector=turns")
    cfg, _ = finished(run)
    assert cfg.collector._target_ == "my_package.turns.Alternating"


@pytest.mark.slow
def test_own_picture(here):
    play = "environment.time_limit_steps=3 policy=stand_still hydra.run.dir=outputs/play/mine"
    pages.run(f"navrl-play {play}")
    pages.run(printed("picture=commands"), "hydra.run.dir=outputs/plot/mine")
    assert matplotlib.image.imread("outputs/plot/mine/commands.png").std() > 0


@pytest.mark.slow
def test_own_world(here, capsys):
    (script,) = [text for text in pages.blocks(PAGE, "python") if "my_package.hall" in text]
    exec(compile(script, "extending.md", "exec"), {"__name__": "script"})
    kind, points, people = capsys.readouterr().out.split()
    assert kind == "hall" and int(points) > 80 and int(people) >= 2
    cfg, _ = finished(here / train("experiment=hall"))
    assert cfg.suite.name == "hall"
    assert {scenario.kind for scenario in instantiate(cfg.suite).scenarios()} == {"hall"}
    assert evaluate("suite=pillar_hall")["by_scenario"].keys() == {"hall"}


@pytest.mark.slow
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


@pytest.mark.slow
def test_own_lidar(here):
    run = here / train("experiment=long_range")
    cfg, _ = finished(run)
    _, td = first_episodes(run)
    assert td["ranges"].shape[-1] == 720 and td["points"].shape[-2:] == (180, 2)
    assert 3.5 < td["ranges"].max() <= 8.0
    assert cfg.transforms.normalize.scale == cfg.transforms.tagd.max_range == 8.0


@pytest.mark.slow
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


def test_own_algorithm(here):
    run = here / train("algorithm=plain")
    cfg, columns = finished(run)
    assert cfg.algorithm._target_ == "my_package.plain.PlainDDPG"
    assert {"loss_actor", "loss_value"} <= {column.rpartition("/")[2] for column in columns}


def test_algorithm_without_the_members_is_rejected(here, capsys):
    words = ["algorithm._target_=builtins.dict", *pages.TINY_TRAINING]
    with pytest.raises(SystemExit, match="2"):
        pages.run(printed("algorithm=plain"), *words)
    assert "algorithm=dict: must have anneal, load_state_dict, precision, state_dict" in (
        capsys.readouterr().err
    )


def test_own_metric(here):
    metrics = evaluate("+metrics.mine._target_=my_package.metrics.backtracking")["metrics"]
    assert metrics["backtracking_m"]["all"]["n"] == 2
    header = Path("outputs/evaluate/mine/episodes.csv").read_text().partition("\n")[0].split(",")
    assert header[-2:] == ["backtracking_m", "error"]


def test_own_controller(here):
    summary = evaluate("policy=mine")
    assert (summary["policy"], summary["errors"], summary["privileged"]) == ("mine", 0, False)


@pytest.mark.slow
def test_own_controller_in_several_processes(here):
    shutil.rmtree("outputs/evaluate/mine", ignore_errors=True)
    tiny = [word for word in TINY_EVALUATION if word != "num_worlds=2"]
    pages.run(printed("policy=mine"), *tiny, "num_processes=2", "num_worlds=1")
    assert json.loads(Path("outputs/evaluate/mine/summary.json").read_text())["errors"] == 0


@pytest.mark.slow
def test_own_function_is_compared_with_paper(here, capsys):
    for name in ("plain", "paper"):
        pages.run(printed(f"hydra.run.dir=outputs/evaluate/{name}"), *TINY_EVALUATION[:-1])
    (command,) = [line for line in COMMANDS if line.endswith("paper outputs/evaluate/plain")]
    words = shlex.split(command)
    with mock.patch.object(sys, "argv", words):
        importlib.import_module("navrl.cli.compare").main()
    assert "| `plain` |" in capsys.readouterr().out


def test_own_stable_baselines3_model(here):
    sb3 = pytest.importorskip("stable_baselines3")
    env = gymnasium.make("navrl/Navigation-v0", overrides=["scenario=corridor", "pool_size=2"])
    sb3.PPO("MultiInputPolicy", env, n_steps=2, batch_size=2).save("ppo.zip")
    shutil.rmtree("outputs/evaluate/mine", ignore_errors=True)
    pages.run(printed("policy=ppo"), *TINY_EVALUATION)
    summary = json.loads(Path("outputs/evaluate/mine/summary.json").read_text())
    assert (summary["policy"], summary["errors"]) == ("ppo", 0)


def test_own_reactive_pedestrians(here, capsys):
    summary = evaluate("pedestrians=fleeing")
    assert summary["simulator"] == "BatchedSimulator with Fleeing"
    assert (summary["suite_version"], summary["errors"]) == (None, 0)
    shutil.rmtree("outputs/evaluate/mine")
    with pytest.raises(SystemExit, match="2"):
        pages.run(printed("pedestrians=fleeing"), *TINY_EVALUATION, "policy=oracle")
    assert "pedestrians=Fleeing: must not be reactive" in capsys.readouterr().err


@pytest.mark.slow
def test_own_base(here):
    run = here / train("robot=omni")
    finished(run)
    summary = evaluate("policy=outputs/train/omni")
    assert (summary["policy"], summary["errors"]) == ("omni", 0)
    runner = PolicyRunner.from_bundle(run / "policy", ["my_package"])
    command = runner.act(torch.full((1440,), 2.0), (0.0, 0.0, 0.0), [(0, 0), (4, 0)])
    assert command.shape == (3,) and abs(command).max() > 0


def test_error_in_a_users_file_is_one_line(here, capsys):
    with pytest.raises(SystemExit, match="2"):
        pages.run(printed("robot=cart"), "+robot.wings=2", *pages.TINY_TRAINING)
    assert capsys.readouterr().err.startswith("navrl: ")


def test_compose_state_is_restored():
    """Commands run in this process must leave no search path behind."""
    with pytest.raises(Exception, match="cart"):
        compose("train", ["robot=cart"])
