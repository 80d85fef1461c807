"""A perturbation changes what is simulated, for bundles and controllers alike."""

import math
import re
from pathlib import Path

import pytest
import yaml
from hydra.errors import HydraException
from nightly import mostly
from omegaconf import OmegaConf

from navrl.config import CONF_DIR, compose, describe, instantiate, nearest_names, options
from navrl.envs.transformed import base_env
from navrl.evaluation import evaluate
from navrl.factory import make_evaluated_policy
from navrl.factory.overrides import check_start
from navrl.factory.perturbation import perturbation_summary, perturbed_parts
from navrl.sim import LimitedDrive
from navrl.worlds import ScenarioBatch

ROOT = Path(__file__).parents[2]
NAMES = options("perturbation")
POLICIES = ("paper", "pure_pursuit", "oracle")
TINY = ["suite=smoke", "suite.num_episodes=2", "num_worlds=2", "num_threads=1"]


def config(policy, name, *overrides):
    return compose("evaluate", [*TINY, f"policy={policy}", f"perturbation={name}", *overrides])


def env_of(policy, name, *overrides):
    """Return the environment that an evaluation steps; built, not played."""
    return base_env(make_evaluated_policy(config(policy, name, *overrides)).env)


def test_unperturbed_configuration_has_no_effect():
    cfg = compose("evaluate")
    assert cfg.perturbation == {
        "name": "none",
        "kind": "none",
        "about": "unperturbed",
        "robot": {},
        "lidar": {},
        "transforms": {},
    }
    assert perturbed_parts(cfg) == {} and perturbation_summary(cfg) == {}
    nominal = compose("evaluate", ["perturbation=nominal"])
    del cfg.perturbation, nominal.perturbation
    assert nominal == cfg


def test_nominal_conditions_are_those_of_the_paper():
    cfg = compose("evaluate", ["perturbation=nominal"])
    parts = perturbed_parts(cfg)
    assert parts["robot"] == OmegaConf.to_container(cfg.robot)
    lidar = OmegaConf.to_container(cfg.lidar)
    assert parts["lidar"].items() <= lidar.items()
    assert lidar.keys() - parts["lidar"].keys() == {
        *("_target_", "num_beams", "max_range", "mount", "angle_min", "angle_increment", "height"),
        "speckle_min_range",
    }


@pytest.mark.parametrize("name", mostly(NAMES, NAMES[::6]))
def test_name_of_each_perturbation_is_that_of_its_option(name):
    node = compose("evaluate", [f"perturbation={name}"]).perturbation
    assert node.name == name and node.about and node.kind


REACHED = [
    ("scan_006", {"delays.scan_age_s": 0.06}),
    ("command_02", {"delays.command_delay_s": 0.2}),
    ("turn_02", {"delays.turn_rate_delay_s": 0.2, "delays.speed_delay_s": 0.0}),
    ("spinning_01", {"delays.revolution_s": 0.1}),
    ("period_03", {"time_step_s": 0.3, "substeps": 15, "robot.max_speed": 1.0}),
    ("wheels_1", {"robot.model": "wheeled", "robot.wheel_acceleration": 1.0}),
    ("speed_05", {"robot.max_speed": 0.5, "robot.model": "kinematic"}),
    ("fov_180", {"lidar.coverage.field_of_view": math.pi, "robot.max_speed": 1.0}),
    ("dropout", {"lidar.errors.dropout": 0.05, "lidar.num_beams": 1440}),
    (
        "turtlebot3",
        {"robot.radius": 0.105, "robot.max_speed": 0.22, "lidar.errors.dropout": 0.0},
    ),
]
BY_DAY = [REACHED[1], REACHED[5]]


@pytest.mark.parametrize("policy", ["paper", "pure_pursuit"])
@pytest.mark.parametrize(("name", "values"), mostly(REACHED, BY_DAY))
def test_perturbation_reaches_the_simulator(policy, name, values):
    simulator = env_of(policy, name).simulator
    for key, value in values.items():
        part = simulator
        for step in key.split("."):
            part = getattr(part, step)
        assert part == value, key


def test_ordinary_robot_combines_all_parts():
    env = env_of("paper", "ordinary")
    simulator = env.simulator
    assert simulator.robot.wheel_acceleration == 1.0 and simulator.robot.model == "wheeled"
    delays = simulator.delays
    assert (delays.scan_age_s, delays.command_delay_s, delays.revolution_s) == (0.1, 0.1, 0.1)
    assert math.isclose(simulator.lidar.coverage.field_of_view, math.radians(270))


def test_capped_speed_is_unknown_to_the_policy():
    env = env_of("paper", "capped_05")
    assert isinstance(env.simulator.robot, LimitedDrive)
    assert float(env.action_spec.high[0, 0]) == 1.0
    assert float(env_of("paper", "speed_05").action_spec.high[0, 0]) == 0.5


def test_time_limit_in_seconds_does_not_depend_on_the_period():
    for name in ("nominal", "period_03", "period_04"):
        env = env_of("pure_pursuit", name)
        assert math.isclose(env.time_limit_steps * env.simulator.time_step_s, 30.0)


def test_localization_is_perturbed():
    assert env_of("paper", "pose_05").localization.age_s == 0.5
    assert env_of("paper", "nominal").localization.is_exact


def test_lidar_of_a_bundle_keeps_its_beams():
    lidar = env_of("perez_darpino", "fov_270").simulator.lidar
    assert lidar.num_beams == 1536 and math.isclose(lidar.coverage.field_of_view, math.radians(270))


def test_controller_knows_the_perturbed_robot():
    assert (
        make_evaluated_policy(config("pure_pursuit", "turtlebot3")).policy.robot.max_speed == 0.22
    )


def test_change_applies_after_the_perturbation():
    robot = env_of("paper", "kobuki_driver", "+change.robot.max_speed=0.3").simulator.robot
    assert robot.max_speed == 0.3 and isinstance(robot, LimitedDrive)


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (["perturbation=scan_01", "timing=ideal"], "timing.delays.scan_age_s=0.0: must be 0.1"),
        (["perturbation=none", "+perturbation.robot.max_speed=0.6"], "max_speed=0.6: must be None"),
        (["perturbation=speed_05", "perturbation.robot.max_speed=0.6"], "max_speed=0.6"),
        (["perturbation=nominal", "robot.max_speed=0.6", "policy=dwa"], "robot.max_speed=0.6"),
    ],
)
def test_contradicting_override_is_an_error(overrides, named):
    with pytest.raises(ValueError, match=re.escape(named)):
        check_start(compose("evaluate", overrides))
    check_start(compose("evaluate", overrides[:1]))


def test_misspelt_perturbation_gets_the_nearest_name():
    with pytest.raises(HydraException) as error:
        compose("evaluate", ["perturbation=scan_1"])
    line = describe(error.value)
    assert line.startswith("Could not find 'perturbation/scan_1'")
    assert "scan_01" in nearest_names(line, "evaluate")


def test_sweeps_and_page_list_each_perturbation():
    files = [CONF_DIR / "sweep" / f"{name}.yaml" for name in ("robustness", "scanners")]
    sweeps = [yaml.safe_load(file.read_text()) for file in files]
    params = [sweep["hydra"]["sweeper"]["params"]["perturbation"] for sweep in sweeps]
    swept = ",".join(params).split(",")
    assert sorted(swept) == sorted([*set(NAMES) - {"none"}, "nominal"])  # nominal in both
    page = (
        (ROOT / "docs" / "robustness.md")
        .read_text()
        .partition("## Perturbations")[2]
        .partition("\n## ")[0]
    )
    rows = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", page, re.M)
    assert sorted(re.findall(r"`(\w+)`", " ".join(rows))) == NAMES


@pytest.fixture(scope="module")
def scenarios():
    suite = instantiate(compose("evaluate", ["suite=smoke"]).suite)
    return ScenarioBatch.pack(suite.scenarios([0, 1]))


@pytest.mark.slow
@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("name", NAMES)
def test_each_perturbation_plays(name, policy, scenarios):
    evaluated = make_evaluated_policy(config(policy, name))
    records = evaluate(evaluated.env, evaluated.policy, scenarios)
    evaluated.env.close()
    assert not any(record.error for record in records)
    if policy == "oracle":
        assert all(r.outcome == "success" for r in records if r.solved)
