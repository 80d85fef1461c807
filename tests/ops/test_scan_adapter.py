"""Scans of any lidar give the points that the policy's own lidar would measure."""

import math

import numpy as np
import pytest
import torch

from navrl.ops.scan_adapter import adapt_scan
from navrl.ops.scan_layout import ScanLayout
from navrl.ops.scanner import BeamState, Scanner

TARGET = ScanLayout(1440, 1)
BEARING = TARGET.beam_bearings().numpy()
FULL = 2.0 * math.pi
DEGREE = math.pi / 180.0


def room(bearing, pose=(0.0, 0.0, 0.0)):
    """Ranges, m, from a pose in a room of 5 by 4 m with a corner pillar ahead to the left."""
    x, y, yaw = pose
    angle = np.asarray(bearing) + yaw + 1e-12
    dx, dy = np.cos(angle), np.sin(angle)
    walls = np.minimum(
        np.where(dx > 0, 3.0 - x, -2.0 - x) / dx, np.where(dy > 0, 2.2 - y, -1.8 - y) / dy
    )
    along = (1.5 - x) * dx + (1.0 - y) * dy
    across = np.abs((1.5 - x) * dy - (1.0 - y) * dx)
    hits = (along > 0) & (across < 0.2)
    near = along - np.sqrt(np.clip(0.04 - across**2, 0, None))
    return np.where(hits, near, walls)


def points(bearing, ranges, pose=(0.0, 0.0, 0.0)):
    angle = np.asarray(bearing) + pose[2]
    return np.stack((np.cos(angle), np.sin(angle)), -1) * np.asarray(ranges)[:, None] + pose[:2]


LIDARS = {
    "360 from -pi": (360, -math.pi, FULL / 360, (0, 0, 0)),
    "360 from -pi to pi, both ends": (360, -math.pi, FULL / 359, (0, 0, 0)),
    "1946": (1946, -math.pi, FULL / 1946, (0, 0, 0)),
    "1947 clockwise, backwards": (1947, math.pi, -FULL / 1947, (0, 0, math.pi)),
    "720": (720, 0.0, FULL / 720, (0, 0, 0)),
    "180 clockwise": (180, 0.0, -FULL / 180, (0, 0, 0)),
    "turned by 5 deg": (1440, 0.0, FULL / 1440, (0, 0, 5 * DEGREE)),
    "10 cm forward": (1440, 0.0, FULL / 1440, (0.1, 0, 0)),
    "off center, backwards": (360, -math.pi, FULL / 360, (-0.08, 0.05, math.pi)),
}


@pytest.mark.parametrize("name", LIDARS)
def test_adapted_scan_has_the_points_of_the_direct_scan(name):
    count, first, step, mount = LIDARS[name]
    scanner = Scanner(first, step, mount=mount, range_max=12.0)
    ranges = torch.tensor(room(scanner.bearings(count), mount))
    scan = adapt_scan(ranges, scanner, TARGET)
    assert (scan.states == BeamState.RETURN).all()
    adapted = points(BEARING, scan.ranges)
    true = points(BEARING, room(BEARING))
    gap = np.linalg.norm(adapted[:, None] - true, axis=-1)
    width = abs(step) * 3.6 + 0.02  # m at the farthest wall, and the wall's own discretization
    assert gap.min(1).max() < width
    assert gap.min(0).max() < max(
        width, 2 * DEGREE * 3.6
    )  # a bin; from off center, parts are hidden


def test_own_layout_is_reproduced():
    ranges = torch.tensor(room(BEARING))
    scan = adapt_scan(ranges, Scanner(), TARGET)
    assert torch.equal(scan.ranges, ranges.float())


def test_wrong_order_gives_other_points():
    """The comparison above notices a mirrored and a turned scan."""
    scanner = Scanner(-math.pi, FULL / 360)
    ranges = torch.tensor(room(scanner.bearings(360)))
    true = room(BEARING)
    for wrong in (Scanner(math.pi, -FULL / 360), Scanner(0.0, FULL / 360)):
        assert np.abs(adapt_scan(ranges, wrong, TARGET).ranges.numpy() - true).max() > 0.5


@pytest.mark.parametrize(("degrees", "count"), [(270, 1081), (240, 682), (180, 361)])
def test_directions_outside_of_the_view_are_not_seen(degrees, count):
    half = degrees / 2 * DEGREE
    scanner = Scanner(-half, 2 * half / (count - 1), range_max=12.0)
    scan = adapt_scan(torch.full((count,), math.inf), scanner, TARGET)
    wrapped = np.abs((BEARING + math.pi) % FULL - math.pi)
    inside = wrapped <= half - 1e-6
    margin = np.abs(wrapped - half) > 0.6 * DEGREE
    assert (scan.states.numpy()[inside] == BeamState.FREE).all()
    assert (scan.states.numpy()[~inside & margin] == BeamState.NOT_SEEN).all()
    assert scan.ranges.isnan().sum() == (scan.states == BeamState.NOT_SEEN).sum() > 300


READINGS = {
    "positive_infinity": math.inf,
    "negative_infinity": -math.inf,
    "nan": math.nan,
    "zero": 0.0,
    "below_range_min": 0.1,
}
MEANINGS = {
    "no_return": BeamState.FREE,
    "too_near": BeamState.TOO_NEAR,
    "invalid": BeamState.NOT_SEEN,
}


@pytest.mark.parametrize("meaning", MEANINGS)
@pytest.mark.parametrize("option", READINGS)
def test_each_reading_has_the_chosen_meaning(option, meaning):
    scanner = Scanner(range_min=0.15, range_max=12.0, **{option: meaning})
    ranges = torch.full((360,), 2.0)
    ranges[90] = READINGS[option]
    scan = adapt_scan(ranges, scanner, TARGET)
    assert scan.states[360] == MEANINGS[meaning] and scan.states[0] == BeamState.RETURN
    expected = {"no_return": math.inf, "too_near": 0.15, "invalid": math.nan}[meaning]
    assert scan.ranges[360].item() == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(
    ("reading", "state"),
    [(12.0, 1), (12.5, 1), (13.0, 1), (13.1, 0), (4000.0, 0), (-1.0, 0), (11.9, 2), (0.15, 2)],
)
def test_range_limits_bound_the_returns(reading, state):
    scanner = Scanner(range_min=0.15, range_max=12.0)
    scan = adapt_scan(torch.full((360,), reading), scanner, TARGET)
    assert (scan.states == state).all()


def test_posts_are_not_seen():
    ranges = torch.full((360,), 2.0)
    ranges[88:93] = 0.13
    by_angle = Scanner(blind_sectors=[(90 * DEGREE, 5 * DEGREE)])
    by_radius = Scanner(own_radius=0.178)
    for scanner in (by_angle, by_radius):
        states = adapt_scan(ranges, scanner, TARGET).states
        assert (states[352:369] == BeamState.NOT_SEEN).all()
        assert (states == BeamState.NOT_SEEN).sum() <= 21
    assert adapt_scan(ranges, Scanner(), TARGET).ranges.min() == pytest.approx(0.13)


def test_motion_of_the_robot_is_compensated():
    """Turning at 1 rad/s and driving at 0.5 m/s while a revolution takes 0.2 s, 0.1 s ago."""
    scanner = Scanner(-math.pi, FULL / 720, mount=(0.05, 0.0, 0.1), range_max=12.0)
    when = np.linspace(-0.3, -0.1, 720)  # s, beam by beam
    frames = np.stack([0.5 * np.sin(when), 0.5 * (1 - np.cos(when)), when], axis=-1)
    mounts = [
        (
            x + 0.05 * math.cos(yaw),
            y + 0.05 * math.sin(yaw),
            yaw + 0.1,
        )
        for x, y, yaw in frames
    ]
    bearing = scanner.bearings(720).numpy()
    ranges = torch.tensor([room([b], pose)[0] for b, pose in zip(bearing, mounts, strict=True)])
    motion = torch.tensor(frames[[0, -1]])
    true = points(BEARING, room(BEARING))

    def error(scan_motion):
        scan = adapt_scan(ranges, scanner, TARGET, scan_motion)
        adapted = points(BEARING, scan.ranges)
        return np.linalg.norm(adapted[:, None] - true, axis=-1).min(1)

    assert error(motion).max() < 0.06
    assert error(None).mean() > 0.1


def test_upside_down_scanner_is_mirrored():
    hanging = Scanner(-math.pi, FULL / 360, is_upside_down=True)
    ranges = torch.tensor(room(-Scanner(-math.pi, FULL / 360).bearings(360)))
    error = np.abs(adapt_scan(ranges, hanging, TARGET).ranges.numpy() - room(BEARING))
    assert np.quantile(error, 0.95) < 0.06


def test_coarse_scanner_leaves_gaps_unseen():
    scan = adapt_scan(torch.full((36,), 2.0), Scanner(), TARGET)  # 10 degrees
    assert 0.15 < (scan.states == BeamState.RETURN).float().mean() < 0.25


def test_target_of_a_partial_circle_and_other_mount():
    target = ScanLayout(181, None, 1, -math.pi / 2, DEGREE, (0.1, 0.0, 0.0))
    ranges = torch.tensor(room(BEARING))
    scan = adapt_scan(ranges, Scanner(), target)
    true = room(target.beam_bearings().numpy(), (0.1, 0.0, 0.0))
    assert np.quantile(np.abs(scan.ranges.numpy() - true), 0.9) < 0.02


def test_batches_equal_single_scans():
    scanner = Scanner(-math.pi, mount=(0.1, 0.0, 0.2), range_max=3.0)
    ranges = 1.0 + 3.0 * torch.rand(5, 400, generator=torch.Generator().manual_seed(0))
    motion = 0.1 * torch.rand(5, 2, 3, generator=torch.Generator().manual_seed(1))
    whole = adapt_scan(ranges, scanner, TARGET, motion)
    for row in range(5):
        single = adapt_scan(ranges[row], scanner, TARGET, motion[row])
        assert torch.equal(single.states, whole.states[row])
        assert torch.equal(single.ranges.nan_to_num(), whole.ranges[row].nan_to_num())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"angle_increment": 0.0}, "angle_increment=0.0: must be finite and not 0"),
        ({"angle_min": math.nan}, "angle_min=nan: must be finite"),
        ({"mount": (0, 0)}, "mount=.*: must be three finite numbers"),
        ({"range_max": 0.1, "range_min": 0.2}, "range_max=0.1: must be above range_min"),
        ({"zero": "far"}, "zero='far': must be one of too_near, no_return, invalid"),
        ({"blind_sectors": [(0.1,)]}, "blind_sectors=.*: must be"),
        ({"own_radius": -1.0}, "own_radius=-1.0: must be finite and >= 0"),
    ],
)
def test_invalid_scanner_is_rejected(arguments, message):
    with pytest.raises(ValueError, match=message):
        Scanner(**arguments)


@pytest.mark.parametrize(
    ("ranges", "motion", "message"),
    [
        (torch.zeros(0), None, r"ranges: must have shape \[\*B, beams\]"),
        (torch.ones(360), torch.zeros(3), r"scan_motion: must have shape \[2, 3\]"),
        (torch.ones(400), None, "angle_increment=.*: must be within one revolution"),
    ],
)
def test_invalid_scan_is_rejected(ranges, motion, message):
    with pytest.raises(ValueError, match=message):
        adapt_scan(ranges, Scanner(angle_increment=DEGREE), TARGET, motion)
