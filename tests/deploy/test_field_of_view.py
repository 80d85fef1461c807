"""Robots whose lidar has blind beams drive if they see ahead."""

import math

import numpy as np
import pytest
import torch

from navrl import factory
from navrl.config import compose, instantiate
from navrl.deploy import DriveState, PolicyRunner, SafetyLimits, ScanCheck
from navrl.policies import ZOO, load_bundle
from navrl.sim import DifferentialDrive, Lidar, Uniform
from navrl.transforms import MinPool

BEAMS = 1440
BEARING = (np.arange(BEAMS) * 2 * np.pi / BEAMS + np.pi) % (2 * np.pi) - np.pi
AHEAD = [(0.1 * i, 0.0) for i in range(41)]  # m


def scan(half_view, outside):
    """Ranges, m, of a wide corridor, with ``outside`` beyond the field of view."""
    ranges = np.minimum(1.5 / np.maximum(np.abs(np.sin(BEARING)), 1e-9), 25.0)
    return np.where(np.abs(BEARING) <= half_view + 1e-9, ranges, outside)


def check(**lidar):
    return ScanCheck(Lidar(BEAMS, **lidar), DifferentialDrive(), SafetyLimits())


@pytest.mark.parametrize("outside", [np.nan, np.inf, 0.0, -np.inf, -1.0, 0.1])
def test_beams_outside_of_a_fixed_view_may_read_anything(outside):
    ranges = scan(math.pi / 3, outside)
    narrow = check(field_of_view=2 * math.pi / 3)
    assert narrow.state(ranges) is DriveState.DRIVE
    cleaned = narrow.cleaned(ranges)
    assert (cleaned[np.abs(BEARING) > math.pi / 3 + 1e-6] == 3.5).all()
    assert not narrow.usable(ranges)[BEAMS // 2] and narrow.usable(ranges)[0]


def test_full_circle_needs_the_beams_ahead():
    assert check().state(scan(math.pi / 3, np.nan)) is DriveState.BLIND
    assert check().state(scan(math.pi / 2, np.nan)) is DriveState.DRIVE


def test_lidar_is_blind_if_it_fails_within_its_view():
    view = check(field_of_view=math.pi)
    ranges = scan(math.pi / 2, np.nan)
    ranges[:60] = np.nan  # 15 degrees
    assert view.state(ranges) is DriveState.BLIND
    assert view.state(np.full(BEAMS, np.inf)) is DriveState.BLIND
    only_behind = np.where(np.abs(BEARING) > 2.0, 1.0, np.inf)
    assert view.state(only_behind) is DriveState.BLIND  # these beams are not the lidar's
    assert check().state(only_behind) is DriveState.DRIVE


@pytest.mark.parametrize(
    "lidar",
    [
        {"field_of_view": math.pi, "mount": (0.0, 0.0, math.pi)},
        {"blind_sectors": [(0.0, 0.4)]},
        {"blind_sectors": [(0.6, 0.4)]},
    ],
)
def test_robot_that_cannot_see_ahead_is_blind(lidar):
    assert check(**lidar).state(scan(math.pi, 1.0)) is DriveState.BLIND


def test_partial_scan_without_beams_ahead_is_blind():
    behind = Lidar(721, angle_min=math.pi / 2, angle_increment=math.pi / 720)
    state = ScanCheck(behind, DifferentialDrive(), SafetyLimits()).state(np.full(721, 2.0))
    assert state is DriveState.BLIND


@pytest.mark.parametrize("reading", [np.nan, 0.155, -np.inf])
def test_posts_do_not_stop_the_robot(reading):
    lidar = instantiate(compose("train", ["lidar=posts"]).lidar)
    posts = ScanCheck(lidar, DifferentialDrive(), SafetyLimits())
    blind = ~lidar.coverage.measured(torch.tensor([0]))[0].numpy()
    ranges = np.where(blind, reading, scan(math.pi, 0.0))
    assert posts.state(ranges) is DriveState.DRIVE
    assert (posts.cleaned(ranges)[blind] == 3.5).all()


def varied_runner():
    """A runner of the paper's policy as if it had been trained with ``lidar=varied``."""
    bundle = load_bundle(ZOO / "paper")
    transforms, robot = bundle.build("transforms"), bundle.build("robot")
    lidar = instantiate(compose("train", ["lidar=varied"]).lidar)
    return PolicyRunner(transforms, bundle.actor, lidar, robot)


@pytest.mark.parametrize("outside", [np.nan, np.inf, 0.0])
@pytest.mark.parametrize("half_view", [math.pi / 2, 2.5])
def test_policy_of_a_varied_lidar_drives_with_any_view(half_view, outside):
    runner = varied_runner()
    for step in range(3):
        pose = (0.1 * step, 0.0, 0.0)
        command = runner.act(scan(half_view, outside), pose, AHEAD)
        assert runner.state is DriveState.DRIVE and np.isfinite(command).all()
    assert runner.act(scan(1.0, np.nan), pose, AHEAD).tolist() == [0.0, 0.0]
    assert runner.state is DriveState.BLIND  # half of the smallest view of the training


def test_bundle_trained_on_varied_sensing_drives_a_robot(tmp_path):
    overrides = [
        *("lidar=varied", "localization=varied", "scenario=corridor", "progress_bar=false"),
        *("num_worlds=2", "num_threads=1", "pool_size=2", "environment.time_limit_steps=6"),
        *("replay.batch_size=4", "replay.capacity=200", "behavior.random_frames=4"),
        *("validation.num_episodes=2", "schedule.total_frames=20", "schedule.learning_starts=8"),
        *("schedule.frames_per_update=8", "schedule.evaluate_every_updates=1"),
    ]
    factory.make_trainer(compose("train", overrides), tmp_path).run()
    runner = PolicyRunner.from_bundle(tmp_path / "policy")
    command = runner.act(scan(math.pi / 2, np.nan), (0.0, 0.0, 0.0), AHEAD)
    assert runner.state is DriveState.DRIVE and np.isfinite(command).all()
    lidar = load_bundle(tmp_path / "policy").build("lidar")
    assert lidar.coverage.field_of_view == Uniform(math.pi, 9.42477796076938)


def seen_steps():
    keys = ["ranges_pooled", "points", "returns", "seen"]
    return MinPool(in_keys=["ranges", "measured"], out_keys=keys)


def test_pooling_reports_the_bins_of_each_episode():
    lidar = Lidar(BEAMS, field_of_view=Uniform(2.0, 6.0))
    measured = lidar.coverage.measured(torch.arange(20))
    ranges = torch.where(measured, 1.0, 3.5)
    _, _, returns, seen = seen_steps()(ranges=ranges, measured=measured)
    assert torch.equal(seen, measured.reshape(20, 180, 8).any(-1))
    assert torch.equal(seen, returns) and len(seen.sum(-1).unique()) > 5


def test_runner_and_environment_see_the_same_bins():
    words = ["lidar=fov_240", "scenario=office", "pool_size=4", "num_threads=1"]
    cfg = compose("train", words)
    env = factory.make_env(
        factory.make_navigation_env(cfg, 1, factory.make_pool(cfg), 0), seen_steps()
    )
    observed = env.reset()
    runner = PolicyRunner(seen_steps(), None, instantiate(cfg.lidar), instantiate(cfg.robot))
    sensed = runner._checked(observed["ranges"][0], (0.0, 0.0, 0.0), AHEAD)
    sensed = runner.transform._reset(sensed, sensed)
    assert torch.equal(sensed["seen"], observed["seen"]) and not observed["seen"].all()
    for key in ("ranges_pooled", "points", "returns"):
        assert torch.equal(sensed[key], observed[key])
