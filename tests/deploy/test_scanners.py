"""A policy drives the same with the scans of other lidars as with its own."""

import math

import numpy as np
import pytest

from navrl import jobs
from navrl.config import compose, options
from navrl.deploy import DriveState, PolicyRunner, adapt_scan, load_scanner
from navrl.policies import ZOO, load_bundle

PRESETS = [name for name in options("scanner") if name != "any"]
FULL_CIRCLE = ["rplidar_a1", "rplidar_a2", "rplidar_a3", "lds_01", "ld14"]


@pytest.fixture(scope="module")
def bundle():
    return load_bundle(ZOO / "paper")


@pytest.fixture(scope="module")
def episode():
    return jobs.record(compose("play", ["policy=paper", "suite=table1", "episode=3"]))


def test_presets_cover_the_documented_lidars():
    assert {"urg_04lx", "utm_30lx", "tim571", *FULL_CIRCLE} == set(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_preset_has_its_field_of_view_and_range(name, bundle):
    scanner = load_scanner(name)
    view = {"utm_30lx": 270, "tim571": 270, "urg_04lx": 240}.get(name, 360)
    step = abs(scanner.increment(scanner.num_beams))
    assert math.degrees(step * scanner.num_beams) == pytest.approx(view, abs=0.8)
    scan = adapt_scan(np.full(scanner.num_beams, 2.0), scanner, bundle.build("lidar"))
    assert np.isnan(scan.ranges).mean() == pytest.approx(1 - view / 360, abs=0.004)
    assert scan.ranges[0] == 2.0


def test_unknown_preset_is_rejected():
    with pytest.raises(ValueError, match="scanner='a9': must be one of any, ld14"):
        load_scanner("a9")


def measured(scanner, ranges):
    """Resample simulated beams to those that a lidar at the same place would report."""
    count = scanner.num_beams
    bearing = scanner.bearings(count).numpy() + scanner.mount[2]
    index = np.round(bearing / (2 * math.pi) * len(ranges)).astype(int) % len(ranges)
    readings = ranges[index]
    return np.where(readings >= 3.5, np.inf, readings)


def drive(bundle, episode, scan_of):
    runner = PolicyRunner.from_bundle(bundle.folder)
    commands = []
    for step in range(episode.num_steps):
        scan = scan_of(episode.ranges[step])
        commands.append(runner.act(scan, episode.pose[step], episode.path))
        assert runner.state is DriveState.DRIVE
    return np.array(commands)


FORWARD, BACKWARD = [(name, 0.0) for name in PRESETS], [(name, math.pi) for name in FULL_CIRCLE]


@pytest.mark.parametrize(("name", "yaw"), FORWARD + BACKWARD)
def test_commands_are_close_to_those_of_the_own_lidar(bundle, episode, name, yaw):
    scanner = load_scanner(name, mount=(0.0, 0.0, yaw), range_max=12.0)
    lidar = bundle.build("lidar")
    commands = drive(
        bundle, episode, lambda ranges: adapt_scan(measured(scanner, ranges), scanner, lidar).ranges
    )
    error = np.abs(commands - episode.action)
    assert np.median(error[:, 0]) < 0.03 and np.median(error[:, 1]) < 0.15


def test_stretched_scan_gives_other_commands(bundle, episode):
    """Without the adapter, a lidar that begins behind drives a mirrored world."""
    stretched = lambda ranges: np.roll(ranges, 720)[::-1]  # noqa: E731
    error = np.abs(drive(bundle, episode, stretched) - episode.action)
    assert np.median(error[:, 1]) > 0.3


def test_scan_of_a_changing_number_of_beams_is_accepted(bundle):
    scanner, lidar = load_scanner("rplidar_a3"), bundle.build("lidar")
    for count in (1946, 1947, 1900):
        scan = adapt_scan(np.full(count, 2.0), scanner, lidar)
        assert (scan.ranges == 2.0).all()


def test_too_near_ahead_blocks_the_runner(bundle):
    runner = PolicyRunner.from_bundle(bundle.folder)
    readings = np.full(360, 2.0)
    readings[180] = -np.inf
    scan = adapt_scan(readings, load_scanner("rplidar_a1"), bundle.build("lidar"))
    assert scan.distances[0] == pytest.approx(0.15) and np.isneginf(scan.ranges[0])
    assert runner.act(scan.ranges, (0, 0, 0), [(0, 0), (4, 0)]).tolist() == [0.0, 0.0]
    assert runner.state is DriveState.BLOCKED


@pytest.mark.parametrize(
    ("ranges", "motion", "message"),
    [
        (np.ones((2, 3)), None, r"ranges.shape=\[2, 3\]: must be \[beams\]"),
        (np.ones(360), np.full((2, 3), np.nan), "scan_motion: must be finite"),
    ],
)
def test_invalid_arguments_are_rejected(bundle, ranges, motion, message):
    with pytest.raises(ValueError, match=message):
        adapt_scan(ranges, load_scanner(), bundle.build("lidar"), motion)
