"""A stranger's bundle allocates what its files hold, and a policy's name is no path."""

import shutil
import tracemalloc
from pathlib import Path

import pytest
import torch
import yaml
from omegaconf import OmegaConf

from navrl.config import compose
from navrl.deploy import PolicyRunner
from navrl.files import write_text
from navrl.jobs.evaluation import make_evaluated_policy
from navrl.policies import ZOO, BundleError, load_bundle


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(ZOO / "paper", tmp_path / "bundles" / "policy")
    return tmp_path / "bundles" / "policy"


def edited(folder, change):
    config = yaml.safe_load((folder / "config.yaml").read_text())
    change(config)
    (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))


@pytest.fixture
def built(monkeypatch):
    """What a test allocates: the largest number of values in a tensor with memory."""
    sizes = [0]
    real = torch.nn.Linear.__init__

    def init(self, in_features, out_features, *args, **kwargs):
        real(self, in_features, out_features, *args, **kwargs)
        sizes.append(0 if self.weight.is_meta else self.weight.numel())

    monkeypatch.setattr(torch.nn.Linear, "__init__", init)
    return sizes


@pytest.mark.parametrize("size", [5_000, 10**9])
def test_oversized_network_allocates_no_memory(folder, built, size):
    edited(folder, lambda config: config["actor"].update(hidden=[size, size]))
    tracemalloc.start()
    with pytest.raises(BundleError, match=r"hidden|does not fit"):
        load_bundle(folder)
    assert max(built) < 10_000
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("lidar", "num_beams", 10**9),
        ("lidar", "num_beams", -(10**9)),
        ("lidar", "num_beams", 50_000),
        ("transforms", "num_points", 50_000),
        ("transforms", "num_groups", 50_000),
        ("transforms", "num_scans", 1_000),
        ("transforms", "max_iterations", 10**5),
        ("transforms", "name", "x" * 5_000),
        ("robot", "radius", 10**40),
    ],
)
def test_a_number_beyond_its_bound_is_named(folder, part, name, value):
    edited(folder, lambda config: config[part].update({"deep": [{name: value}]}))
    with pytest.raises(BundleError, match=rf"{part}\.deep\[0\]\.{name}.*at most"):
        load_bundle(folder)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"num_speeds": 5_000, "num_turn_rates": 2_001}, "num_speeds=5000, num_turn_rates=2001"),
        ({"num_speeds": 50_000}, "num_speeds=50000, num_turn_rates=25"),
        ({"time_step": 1e-6}, "horizon=0.4, time_step=1e-06, checks_per_step=2"),
        ({"horizon": 1e5}, "horizon=100000.0, time_step=0.2"),
        ({"checks_per_step": 50_000}, "checks_per_step=50000"),
    ],
)
def test_a_shield_beyond_its_bounds_is_named(folder, values, message):
    """Products of sizes: each of them alone is allowed."""
    shield = {"_target_": "navrl.transforms.ActionShield", **values}
    edited(folder, lambda config: config["transforms"].update(shield=shield))
    with pytest.raises(BundleError, match=rf"{message}.*at most"):
        load_bundle(folder)


def test_pooling_with_unbalanced_bins_is_rejected(folder):
    """The table of beams by bin would have 64 million entries."""
    change = {"group_size": None, "num_points": 8_000, "angle_increment": 1e-9}
    lidar = {"num_beams": 8_000, "angle_increment": 1e-9}
    edited(folder, lambda config: config["lidar"].update(lidar))
    edited(folder, lambda config: config["transforms"]["min_pool"].update(change))
    with pytest.raises(ValueError, match=r"num_points=8000.*8000 beams.*at most"):
        PolicyRunner.from_bundle(folder)


def test_config_nesting_is_bounded(folder):
    node = {"a": 1}
    for _ in range(100):
        node = {"a": node}
    edited(folder, lambda config: config["lidar"].update(deep=node))
    with pytest.raises(BundleError, match="nested"):
        load_bundle(folder)


@pytest.mark.parametrize("name", ["BatchedSimulator", "BulletSimulator", "Simulator"])
def test_simulator_in_a_policy_is_rejected(folder, name):
    edited(folder, lambda config: config.update(lidar={"_target_": f"navrl.sim.{name}"}))
    with pytest.raises(BundleError, match="_target_"):
        load_bundle(folder)


def test_the_shipped_policies_are_far_from_the_bounds():
    for zoo in sorted(path.parent for path in ZOO.glob("*/config.yaml")):
        load_bundle(zoo)


@pytest.mark.parametrize("form", ["absolute", "relative", "inside"])
def test_policy_cannot_reference_another_config(tmp_path, form):
    mark = tmp_path / "ran"
    node = {"_target_": "pathlib.Path.touch", "_args_": [str(mark)]}
    OmegaConf.save(OmegaConf.create(node), tmp_path / "other.yaml")
    policy = {
        "absolute": str(tmp_path / "other"),
        "relative": "../" * 20 + str(tmp_path / "other").lstrip("/"),
        "inside": "../controller/pure_pursuit",
    }[form]
    cfg = compose("evaluate", ["suite=smoke"])
    cfg.policy = policy
    with pytest.raises(ValueError, match="no such bundle or controller"):
        make_evaluated_policy(cfg)
    assert not mark.exists()


def test_interrupted_save_preserves_the_old_bundle(folder, monkeypatch):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    bundle = load_bundle(folder)
    from navrl.policies import bundle as module

    def full(file, text):
        if Path(file).name == "card.md":
            raise OSError(28, "No space left on device", str(file))
        return write_text(file, text)

    monkeypatch.setattr(module, "write_text", full)
    with pytest.raises(OSError, match=r"card\.md"):
        module.save_bundle(
            folder,
            config=yaml.safe_load((folder / "config.yaml").read_text()),
            actor=bundle.actor,
            metrics={},
            card="",
        )
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]
