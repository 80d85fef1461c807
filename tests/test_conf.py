"""Every YAML node is a call that its target would accept; every experiment trains."""

import importlib
import inspect
from pathlib import Path

import pytest
from nightly import mostly
from omegaconf import OmegaConf

from navrl import factory, jobs
from navrl.config import CONF_DIR, check_types, compose

FILES = sorted(CONF_DIR.rglob("*.yaml"))
BY_DAY = ["paper", "ppo"]
EXPERIMENTS = sorted(path.stem for path in (CONF_DIR / "experiment").glob("*.yaml"))


EVALUATION = [
    "suite=smoke",
    "suite.num_episodes=4",
    "num_worlds=4",
    "num_threads=1",
    "environment.time_limit_steps=10",
    "progress_bar=false",
]


def nodes(value):
    if isinstance(value, dict):
        if "_target_" in value:
            yield value
        for item in value.values():
            yield from nodes(item)


def resolve(target: str):
    module, _, name = target.rpartition(".")
    return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(CONF_DIR)))
def test_nodes_bind_to_the_signatures_of_their_targets(path):
    for node in nodes(OmegaConf.to_container(OmegaConf.load(path), resolve=False)):
        target = resolve(node["_target_"])
        arguments = {k: v for k, v in node.items() if not k.startswith("_") and k != "defaults"}
        inspect.signature(target).bind_partial(**arguments)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(CONF_DIR)))
def test_default_of_a_float_argument_is_a_float(path):
    """An override is compared with the type of the default: after 60 only integers are taken."""
    for node in nodes(OmegaConf.to_container(OmegaConf.load(path), resolve=False)):
        arguments = inspect.signature(resolve(node["_target_"])).parameters
        for name, value in node.items():
            if type(value) is int and name in arguments:
                annotation = str(arguments[name].annotation)
                assert "float" not in annotation or "int" in annotation, f"{name}: {value}"


def test_composed_options_bind_to_target_signatures():
    """Arguments that a file inherits, or adds to those it inherits, are checked together."""
    names = [
        (path.parent.relative_to(CONF_DIR).as_posix(), path.stem)
        for path in FILES
        if path.parent.parent == CONF_DIR and "# @package _global_" not in path.read_text()
    ]
    overrides = [f"+{group}@{group}.{name}={name}" for group, name in names]
    composed = OmegaConf.to_container(compose(None, overrides), resolve=False)
    for node in nodes(composed):
        inspect.signature(resolve(node["_target_"])).bind_partial(
            **{key: value for key, value in node.items() if not key.startswith("_")}
        )


@pytest.mark.parametrize("override", ["checkpoint_every_s=0.5", "frames_per_update=0.5"])
@pytest.mark.parametrize(
    "choice", mostly(["schedule=quick", "schedule=standard", "hardware=gpu"], ["hardware=gpu"])
)
def test_schedules_accept_fractions(override, choice):
    check_types("train", [choice, f"schedule.{override}"])


@pytest.mark.parametrize(
    "name", mostly([name for name in EXPERIMENTS if name != "ppo"], ["navrl-best-varied"])
)
@pytest.mark.parametrize(
    "algorithm",
    mostly(["ddpg", "ddpg_annealed", "td3", "td3_navrl_best", "sac"], ["ddpg_annealed", "sac"]),
)
def test_off_policy_algorithms_are_exchangeable(name, algorithm):
    """An experiment sets no key of its algorithm that another one lacks."""
    node = compose("train", [f"experiment={name}", f"algorithm={algorithm}"]).algorithm
    arguments = {k: v for k, v in node.items() if not k.startswith("_")}
    inspect.signature(resolve(node["_target_"])).bind_partial(**arguments)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(CONF_DIR)))
def test_numbers_have_a_unit_or_source(path):
    for line in path.read_text().splitlines():
        if line.startswith("#"):
            continue
        key, _, value = line.partition(": ")
        is_number = bool(value) and value[0].isdigit() and "experiment" not in path.parts
        assert not is_number or "#" in value, f"{path.name}: {key} has no comment"


@pytest.mark.parametrize("name", mostly(EXPERIMENTS, BY_DAY))
def test_all_experiments_train(name, tmp_path):
    on_policy = compose("train", [f"experiment={name}"]).replay._target_.endswith("Rollouts")
    replay = ["replay.num_steps=4", "schedule.learning_starts=0"]
    if not on_policy:
        replay = ["replay.batch_size=4", "replay.capacity=200", "schedule.learning_starts=8"]
    overrides = [
        f"experiment={name}",
        "num_worlds=2",
        "num_threads=1",
        "pool_size=2",
        "scenario=corridor",
        *replay,
        "behavior.random_frames=4",
        "validation.num_episodes=2",
        "environment.time_limit_steps=6",
        "schedule.total_frames=40",
        "schedule.frames_per_update=8",
        "schedule.evaluate_every_updates=2",
        "schedule.log_every_updates=2",
        "progress_bar=false",
    ]
    progress = factory.make_trainer(compose("train", overrides), tmp_path).run()
    assert progress.frames == 40
    assert progress.updates >= 4
    summary = jobs.run_evaluation(
        compose("evaluate", [f"policy={tmp_path}", *EVALUATION]), tmp_path
    )
    assert (summary["episodes"], summary["errors"]) == (4, 0)


def test_ablations_differ_from_the_paper_as_documented():
    size = {}
    for name in ("paper", "no_spatial", "no_temporal", "no_tagd"):
        cfg = compose("train", [f"experiment={name}"])
        shapes = {
            "spatial": [180, 2],
            "spatial_previous": [180, 2],
            "temporal": [30, 4],
            "waypoints_scaled": [5, 2],
        }
        actor, _ = factory.make_agent(cfg, shapes)
        size[name] = sum(p.numel() for p in actor.parameters())
    head = 30 * 128  # what the output module reads of a stream
    assert size["paper"] == 147_948
    assert size["no_spatial"] == 147_948 - 64_821 - head
    assert size["no_temporal"] == 147_948 - 62_773 - head
    assert size["no_tagd"] == 147_948 + 64_821 - 62_773


def test_experiments_are_short():
    for path in (CONF_DIR / "experiment").glob("*.yaml"):
        lines = [x for x in path.read_text().splitlines() if x.strip() and x[0] != "#"]
        assert len(lines) <= 13, path.name
    for name in ("no_spatial", "no_temporal", "no_tagd"):
        text = Path(CONF_DIR / "experiment" / f"{name}.yaml").read_text()
        assert len([x for x in text.splitlines() if x.strip() and x[0] != "#"]) <= 3
