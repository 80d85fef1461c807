"""A policy with other settings becomes a bundle that runs wherever bundles run."""

import json

import numpy as np
import pytest
import torch

from navrl.config import compose
from navrl.deploy import Controller, PolicyRunner
from navrl.factory.policy import make_runner
from navrl.jobs.changed_bundle import export_bundle
from navrl.policies import ZOO, load_bundle

PRIOR = "+transforms/steps@change.transforms=odometry_prior"
PATH = np.stack((np.linspace(0.0, 4.0, 41), np.zeros(41)), -1)


def config(*overrides):
    return compose("export", ["policy=paper", "format=bundle", *overrides])


def commands(runner):
    random = np.random.default_rng(0)
    scans = 2.0 + 0.1 * random.random((4, 1440))
    return np.array([runner.act(s, (0.05 * k, 0.0, 0.02 * k), PATH) for k, s in enumerate(scans)])


@pytest.fixture(scope="module")
def changed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundles") / "mine"
    export_bundle(config(PRIOR, "+change.lidar.height=0.25"), folder)
    return folder


def test_bundle_has_the_changes_and_the_same_weights(changed):
    found, own = load_bundle(changed), load_bundle(ZOO / "paper")
    assert found.config["transforms"]["icp_align"]["prior"] == "pose"
    assert found.config["lidar"]["height"] == 0.25 and own.config["lidar"].get("height") != 0.25
    assert found.config["actor"] == own.config["actor"]
    weights = own.actor.state_dict()
    assert all(torch.equal(value, weights[k]) for k, value in found.actor.state_dict().items())


def test_bundle_drives_as_the_changed_policy(changed):
    with_changes = commands(make_runner(config(PRIOR)))
    assert np.array_equal(commands(PolicyRunner.from_bundle(changed)), with_changes)
    assert not np.array_equal(commands(PolicyRunner.from_bundle(ZOO / "paper")), with_changes)
    assert Controller.from_bundle(changed, "rplidar_a1").warm_up() is None


def test_bundle_has_no_scores_and_lists_the_changes(changed):
    assert json.loads((changed / "metrics.json").read_text()) == {}
    card = (changed / "card.md").read_text()
    assert "`transforms.icp_align.prior=pose`" in card and "not been scored" in card


def test_perturbed_robot_is_that_of_the_bundle(tmp_path):
    export_bundle(config("perturbation=turtlebot3"), tmp_path / "slow")
    assert load_bundle(tmp_path / "slow").build("robot").command_limits[1][0] == 0.22


def test_bundle_for_another_lidar_reads_its_beams(tmp_path):
    export_bundle(config("perturbation=rplidar_a1"), tmp_path / "a1")
    runner = PolicyRunner.from_bundle(tmp_path / "a1")
    own = PolicyRunner.from_bundle(ZOO / "paper")
    front = np.where(np.abs(np.arange(360) - 180) < 10, 1.0, 2.0)  # beam 180 looks ahead
    command = runner.act(front, (0.0, 0.0, 0.0), PATH)
    ahead = np.roll(np.repeat(np.roll(front, -180), 4), -2)
    np.testing.assert_allclose(command, own.act(ahead, (0.0, 0.0, 0.0), PATH), atol=0.05)


def test_controllers_and_existing_folders_raise_errors(changed):
    with pytest.raises(ValueError, match="mine: must not exist"):
        export_bundle(config(), changed)
    with pytest.raises(ValueError, match="policy=dwa: must be a bundle"):
        export_bundle(compose("export", ["policy=dwa"]), changed.with_name("other"))


def test_change_that_a_bundle_may_not_have_leaves_nothing(tmp_path):
    cfg = config("+change.transforms.mine._target_=collections.OrderedDict")
    with pytest.raises(ValueError, match=r"must be exported by navrl\.transforms"):
        export_bundle(cfg, tmp_path / "mine")
    assert not list(tmp_path.iterdir())
