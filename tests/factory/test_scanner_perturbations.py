"""A policy is evaluated with the beams of another lidar, resampled to its own."""

import math

import pytest
import torch
from nightly import mostly
from omegaconf import OmegaConf

from navrl.config import compose, instantiate, options
from navrl.envs.transformed import base_env
from navrl.evaluation.robustness import KINDS
from navrl.factory import make_evaluated_policy
from navrl.factory.perturbation import perturbation_summary, with_policy_beams
from navrl.factory.policy import with_parts
from navrl.policies import ZOO, load_bundle
from navrl.transforms import ScanAdapter
from navrl.worlds import ScenarioBatch

SCANNERS = sorted(set(options("scanner")) - {"any"})
BY_DAY = ["ld14", "rplidar_a1"]
TINY = ["suite=smoke", "suite.num_episodes=2", "num_worlds=2", "num_threads=1"]
NOISELESS = "+change.lidar.noise=none"


def evaluated(policy, name, *overrides):
    cfg = compose("evaluate", [*TINY, f"policy={policy}", f"perturbation={name}", *overrides])
    return make_evaluated_policy(cfg).env


def first_observation(env):
    suite = instantiate(compose("evaluate", ["suite=smoke"]).suite)
    base_env(env).set_scenarios(ScenarioBatch.pack(suite.scenarios([0, 1])))
    return env.reset()


def test_each_scanner_is_a_perturbation():
    assert set(SCANNERS) <= set(options("perturbation"))
    summary = perturbation_summary(compose("evaluate", ["perturbation=ld14"]))["perturbation"]
    assert summary["kind"] == "scanner" == KINDS[-1]


@pytest.mark.parametrize("name", mostly(SCANNERS, BY_DAY))
def test_lidar_has_the_beams_of_the_scanner(name):
    env = evaluated("paper", name)
    scanner = instantiate(compose("export", [f"+scanner={name}"]).scanner)
    lidar = base_env(env).simulator.lidar
    assert (lidar.num_beams, lidar.angle_min) == (scanner.num_beams, scanner.angle_min)
    assert lidar.angle_increment == scanner.angle_increment
    assert isinstance(env.transform[0], ScanAdapter) and env.transform[0].scanner == scanner


@pytest.mark.parametrize("name", mostly(SCANNERS, BY_DAY))
@pytest.mark.parametrize("policy", ["paper", "dwa"])
def test_walls_are_where_the_own_lidar_sees_them(policy, name):
    own = first_observation(evaluated(policy, "nominal", NOISELESS))["ranges_pooled"]
    seen = first_observation(evaluated(policy, name, NOISELESS))["ranges_pooled"]
    bearing = (torch.arange(180) + 0.5) * math.pi / 90 - math.pi / 1440
    bearing = torch.remainder(bearing + math.pi, 2 * math.pi) - math.pi
    view = {"urg_04lx": 240, "utm_30lx": 270, "tim571": 270}.get(name, 360)
    inside = bearing.abs() < math.radians(view / 2 - 2)
    outside = bearing.abs() > math.radians(view / 2 + 2)
    assert own.shape == seen.shape == (2, 180)
    # A coarse lidar meets another point of a wall seen at a flat angle, and edges in other bins.
    assert ((own - seen)[:, inside].abs() < 0.1).float().mean() > 0.9
    assert (seen[:, outside] == 3.5).all()


def test_raw_scans_remain_those_of_the_lidar():
    observed = first_observation(evaluated("paper", "rplidar_a1"))
    assert observed["ranges"].shape == (2, 360)
    assert observed["ranges_adapted"].shape == observed["measured_adapted"].shape == (2, 1440)


def test_beams_are_those_of_the_policys_own_lidar():
    adapter = evaluated("perez_darpino", "rplidar_a1").transform[0]
    assert adapter.target.num_beams == 1536


def test_mount_of_the_policys_lidar_is_that_of_the_scanner():
    env = evaluated("pure_pursuit", "rplidar_a1", "lidar.mount=[0.1,0.0,3.0]")
    adapter = env.transform[0]
    assert base_env(env).simulator.lidar.mount == (0.1, 0.0, 3.0)
    assert tuple(adapter.scanner.mount) == (0.1, 0.0, 3.0) == adapter.target.mount


def test_pooling_after_an_adapter_must_have_its_angles():
    wrong = "+change.transforms.scan_adapter.angle_min=1.0"
    with pytest.raises(ValueError, match=r"lidar.angle_min=1.0: must be the angle_min of MinPool"):
        evaluated("paper", "rplidar_a1", wrong)


@pytest.mark.parametrize("name", ["rplidar_a1", "ld14"])
def test_changed_mount_of_the_lidar_is_that_of_the_scanner(name):
    own = first_observation(evaluated("paper", "nominal", NOISELESS))["ranges_pooled"]
    turned = "+change.lidar.mount=[0.0,0.0,3.1]"
    env = evaluated("paper", name, NOISELESS, turned)
    assert env.transform[0].target.mount == (0.0, 0.0, 0.0)
    seen = first_observation(env)["ranges_pooled"]
    assert ((own - seen).abs() < 0.1).float().mean() > 0.9


OTHERS = [
    ("scanner.num_beams=100", "lidar.num_beams=360: must be the num_beams of the scanner"),
    ("scanner.angle_min=1.0", r"lidar.angle_min=-3.14\d*: must be the angle_min of the scan"),
    ("scanner.angle_increment=-0.01", "lidar.angle_increment=0.017.*: must be the angle_incr"),
    ("scanner.mount=[0.1,0,0]", r"lidar.mount=\[0.0, 0.0, 0.0\]: must be the mount of the sc"),
]


@pytest.mark.parametrize(("change", "name"), mostly(OTHERS, OTHERS[:1]))
def test_scanner_must_be_the_lidar(change, name):
    with pytest.raises(ValueError, match=f"{name}.*set both, transforms.scan_adapter.scanner"):
        evaluated("paper", "rplidar_a1", f"+change.transforms.scan_adapter.{change}")


def test_policy_with_an_adapter_has_no_scanner_perturbation():
    cfg = compose("evaluate", [*TINY, "policy=paper", "perturbation=rplidar_a1"])
    parts = OmegaConf.to_container(with_parts(cfg, load_bundle(ZOO / "paper").config))
    wanted = r"perturbation=rplidar_a1: must be none .* transforms.scan_adapter adapts"
    with pytest.raises(ValueError, match=wanted):
        with_policy_beams(cfg, parts, {})
