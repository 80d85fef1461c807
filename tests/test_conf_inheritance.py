"""Configurations inherit instead of repeating values; their groups are documented."""

import itertools
import re
from pathlib import Path

import pytest
import yaml
from hydra.errors import HydraException
from nightly import mostly
from omegaconf import OmegaConf

from navrl.config import CONF_DIR, compose, describe, nearest_names, options

INHERITED = ("base", "family")  # folders of files that are inherited, not chosen
MAX_EQUAL = 3  # equal values of two files of a group
ENVIRONMENT = {"goal_radius": 0.2, "time_limit_steps": 150}
KOBUKI_SMOOTHER = {
    "linear_acceleration": 0.3,
    "linear_deceleration": 0.3,
    "angular_deceleration": 3.5,
}
TURTLEBOT3 = {
    "radius": 0.105,
    "wheel_separation": 0.16,
    "max_speed": 0.22,
    "max_turn_rate": 1.0,
    "linear_acceleration": 2.5,
    "angular_acceleration": 3.2,
}
PAGE = Path(__file__).parents[1] / "docs" / "configuration.md"


def option(group, name):
    """Return the composed option of a group, interpolations as they are written."""
    node = compose(None, [f"+{group}@node={name}"]).node
    return OmegaConf.to_container(node, resolve=False)


@pytest.mark.parametrize(
    "group, name, base, differences",
    [
        ("controller", "dwa_predictive", "dwa", {"predict_motion": True}),
        ("robot", "kobuki_wheeled", "kobuki", {"model": "wheeled", "wheel_acceleration": 2.0}),
        ("robot", "kobuki_real", "kobuki_wheeled", {"max_speed": 0.7, "wheel_acceleration": 1.0}),
        ("robot", "wheels_1", "kobuki_wheeled", {"wheel_acceleration": 1.0}),
        ("robot", "kobuki_smoother", "kobuki_driver", KOBUKI_SMOOTHER),
        ("robot", "turtlebot3", "limited", TURTLEBOT3),
        ("lidar", "rplidar_a3_1536", "rplidar_a3", {"num_beams": 1536}),
    ],
)
def test_option_differs_from_its_base_only_by(group, name, base, differences):
    assert option(group, name) == option(group, base) | differences


def test_simulators_share_their_arguments():
    batched, bullet = option("simulator", "batched"), option("simulator", "bullet")
    assert batched.pop("_target_") == "navrl.sim.BatchedSimulator"
    assert bullet.pop("_target_") == "navrl.sim.BulletSimulator"
    assert (batched.pop("max_walls"), bullet.pop("gui")) == (32, False)
    assert batched == bullet and len(batched) == 9


@pytest.mark.parametrize("command", mostly(["train", "evaluate", "play", "benchmark"], ["play"]))
def test_commands_share_the_environment_group(command):
    assert compose(command).environment == ENVIRONMENT
    changed = compose(command, ["environment=paper", "environment.time_limit_steps=3"])
    assert changed.environment == ENVIRONMENT | {"time_limit_steps": 3}


def suite(name):
    return OmegaConf.to_container(compose("evaluate", [f"suite={name}"]).suite, resolve=True)


@pytest.mark.parametrize("world", ["corridor", "intersection", "office"])
def test_speed_and_density_suites_differ_from_table1_only_by(world):
    expected, scenes = suite("table1"), f"sweep_{world}"
    worlds = expected["distribution"]["worlds"]
    worlds |= {other: None for other in worlds if other != world}
    expected |= {"name": f"speed_{world}_0.6", "scenes": scenes}
    assert suite(f"speed_{world}") == expected
    version = 2 if world == "office" else 1
    expected |= {"name": f"density_{world}_2", "version": version}
    expected["distribution"] |= {"num_dynamic": [8, 8], "keep_dynamic": 2}
    assert suite(f"density_{world}") == expected


def test_members_of_families_are_options():
    files = (CONF_DIR / "suite" / "family").glob("*.yaml")
    members = {name for file in files for name in yaml.safe_load(file.read_text())["members"]}
    assert len(members) == 6
    assert members <= set(options("suite"))
    assert not {"speed", "density", "family"} & set(options("suite"))


@pytest.mark.parametrize(
    "name, hint",
    [
        ("speed_ofice", "speed_office"),
        ("density", "density_corridor or density_intersection or density_office"),
        ("speed", "speed_corridor or speed_intersection or speed_office"),
    ],
)
def test_misspelt_member_gets_the_nearest_names(name, hint):
    with pytest.raises(HydraException) as error:
        compose("evaluate", [f"suite={name}"])
    found = nearest_names(describe(error.value), "evaluate")
    assert hint in found


def test_own_files_inherit_members_and_have_other_names(tmp_path):
    (tmp_path / "suite").mkdir()
    inherits = "defaults: [density_office, _self_]\nnum_episodes: 5\n"
    (tmp_path / "suite" / "crowded.yaml").write_text(inherits)
    (tmp_path / "suite" / "speed_corridor.yaml").write_text("defaults: [table1]\n")
    search = f"hydra.searchpath=[file://{tmp_path}]"
    crowded = compose("evaluate", [search, "suite=crowded"]).suite
    assert (crowded.name, crowded.num_episodes) == ("density_office_2", 5)
    with pytest.raises(HydraException) as error:
        compose("evaluate", [search, "suite=speed_corridor"])
    expected = "suite/speed_corridor: must have another name, navrl has an option of this one"
    assert describe(error.value) == expected


def test_error_of_a_group_does_not_name_inherited_files():
    with pytest.raises(HydraException) as error:
        compose("train", ["environment=papr"])
    assert describe(error.value).startswith("Could not find 'environment/papr'")
    assert nearest_names(describe(error.value), "train") == "; did you mean paper?"


def leaves(value, prefix=""):
    """Yield key and value of everything but the wiring: interpolations and constructors."""
    for key, item in value.items():
        if isinstance(item, dict):
            yield from leaves(item, f"{prefix}{key}.")
        elif key == "defaults":
            yield from (
                (group, str(name))
                for entry in item
                if isinstance(entry, dict)
                for group, name in entry.items()
            )
        elif key not in ("_target_", "_partial_") and "$" not in str(item):
            yield f"{prefix}{key}", str(item)


def repeated(folder):
    """Return the pairs of files of a folder with more than ``MAX_EQUAL`` equal values."""
    values = {
        path: set(leaves(yaml.safe_load(path.read_text()) or {}))
        for path in sorted(folder.rglob("*.yaml"))
    }
    pairs = itertools.combinations(values, 2)
    found = {(a, b): values[a] & values[b] for a, b in pairs if a.parent == b.parent}
    return {
        f"{a.relative_to(folder)} {b.relative_to(folder)}": sorted(equal)
        for (a, b), equal in found.items()
        if len(equal) > MAX_EQUAL
    }


def test_files_of_a_group_do_not_repeat_values():
    assert repeated(CONF_DIR) == {}


def test_repeated_values_are_found(tmp_path):
    text = "defaults:\n  - _self_\na: 1\nb: {c: 2, d: [3]}\ne: null\n"
    (tmp_path / "one.yaml").write_text(text)
    (tmp_path / "other.yaml").write_text(f"{text}f: 4\n")
    assert list(repeated(tmp_path)) == ["one.yaml other.yaml"]


def test_documented_groups_are_the_folders_of_conf():
    files = [path.relative_to(CONF_DIR).parent for path in CONF_DIR.rglob("*.yaml")]
    groups = {folder.as_posix() for folder in files if folder.name not in INHERITED}
    listed = re.search(r"Groups: `([^`]+)`", PAGE.read_text())[1].split()
    assert sorted(listed) == sorted(groups - {"."})
