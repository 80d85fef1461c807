"""Scans of a moving robot, measured by rays from where it was, moved to where it is."""

import math

import pytest
import torch
from contract import TransformContract
from tensordict import TensorDict

from navrl import keys
from navrl.ops import se2
from navrl.ops.projection import bin_bearings
from navrl.ops.raycast import cast_rays
from navrl.ops.unicycle import advance_poses
from navrl.transforms import ICPAlign, MinPool, MotionCompensation, RangeHistory, ScanHistory
from navrl.transforms.pipeline import compose

MEASURED = (keys.RANGES_MEASURED, keys.POINTS_MEASURED, keys.RETURNS_MEASURED)
BEAM = 2 * math.pi / 1440
HALF = torch.tensor([2.5, 1.5])  # m, half sizes of the room
WALLS = torch.tensor(
    [
        [2.6, 0.0, 0.1, 1.7, 0.0],
        [-2.6, 0.0, 0.1, 1.7, 0.0],
        [0.0, 1.6, 2.7, 0.1, 0.0],
        [0.0, -1.6, 2.7, 0.1, 0.0],
    ]
)
START = torch.tensor([-0.5, 0.2, 0.3], dtype=torch.float64)
TURNING = torch.tensor([0.5, 2.0], dtype=torch.float64)


def drive(velocity, *, age=0.0, revolution=0.0, num_beams=1440, angles=(0.0, None), walls=WALLS):
    """Return the scan of a robot that drives for ``revolution`` and then for ``age`` seconds.

    Returns:
        Ranges ``[beams]``, the motion ``[2, 3]`` and the robot's present pose ``[3]``.
    """
    times = torch.linspace(0.0, revolution, num_beams, dtype=torch.float64).tolist()
    poses = torch.stack([advance_poses(START, velocity, time) for time in times])
    scans = cast_rays(
        poses,
        walls.double().expand(num_beams, -1, -1),
        num_beams=num_beams,
        angle_min=angles[0],
        angle_increment=angles[1],
    )
    present = advance_poses(START, velocity, revolution + age)
    motion = se2.relative(present.expand(2, 3), poses[[0, -1]])
    return scans.diagonal(), motion, present


def observe(ranges, entry, pool=None, **options):
    pool = pool or MinPool(bearing="beam", out_keys=MEASURED)
    data = TensorDict({keys.RANGES: ranges.unsqueeze(0), **entry}, [1])
    return MotionCompensation(**options)(pool(data))


def off_the_walls(points, returns, pose):
    """Return the largest distance of a measured return from the walls, m.

    Filled gaps are on the centers of their bins; at a corner they lie on the line between both
    walls.
    """
    bearing = torch.atan2(points[0, :, 1], points[0, :, 0])
    off_center = se2.wrap_angle(bearing - bin_bearings(points.shape[1], 8)).abs()
    is_measured = returns[0] & (off_center > 1e-5)
    assert is_measured.float().mean() > 0.7
    world = se2.transform_points(pose.float(), points[0])[is_measured]
    return (HALF - world.abs()).abs().amin(-1).max()


class TestMotionCompensation(TransformContract):
    tolerance = 1e-6

    def before(self):
        return [MinPool(group_size=4, out_keys=MEASURED)]

    def make(self, **kwargs):
        return MotionCompensation(group_size=4, **kwargs)

    def in_foreign_env(self):
        measured = [["raw", "r"], ["raw", "xy"], ["raw", "hit"]]
        return [
            MinPool(3, 2.5, in_keys=["laser"], out_keys=measured),
            MotionCompensation(
                group_size=3,
                max_range=2.5,
                in_keys=[*measured[1:], "sweep"],
                out_keys=[["scan", "xy"], ["scan", "hit"], ["scan", "r"]],
            ),
        ]


@pytest.mark.parametrize("velocity", [(0.5, 0.0), (0.5, 2.0), (0.0, -3.0)])
def test_old_scan_lies_on_the_walls(velocity):
    velocity = torch.tensor(velocity, dtype=torch.float64)
    ranges, motion, pose = drive(velocity, age=0.2)
    scan = observe(ranges, {keys.SCAN_MOTION: motion.unsqueeze(0)})
    assert scan[keys.RETURNS].sum() > 150
    assert off_the_walls(scan[keys.POINTS], scan[keys.RETURNS], pose) < 1e-3
    measured = off_the_walls(scan[keys.POINTS_MEASURED], scan[keys.RETURNS_MEASURED], pose)
    assert measured > 0.06  # 0.1 m driven at 0.3 rad to the walls, or up to 0.6 rad turned


@pytest.mark.parametrize(
    "angles", [(0.0, None), (-math.pi, None), (math.pi - BEAM, -BEAM), (1.0, None)]
)
def test_spinning_scan_is_straightened(angles):
    ranges, motion, pose = drive(TURNING, revolution=0.1, angles=angles)
    pool = MinPool(bearing="beam", angle_min=angles[0], angle_increment=angles[1],
                   out_keys=MEASURED)  # fmt: skip
    entry = {keys.SCAN_MOTION: motion.unsqueeze(0)}
    scan = observe(ranges, entry, pool, angle_min=angles[0], angle_increment=angles[1])
    # a bin is 0.55 ms long, and an arc is up to 1.3 mm from its chord; 1.0 rad is within a bin
    limit = 0.005 if angles[0] != 1.0 else 0.1
    assert off_the_walls(scan[keys.POINTS], scan[keys.RETURNS], pose) < limit
    measured = off_the_walls(scan[keys.POINTS_MEASURED], scan[keys.RETURNS_MEASURED], pose)
    assert measured > 0.1


def test_wrong_direction_of_the_beams_is_visible():
    ranges, motion, pose = drive(TURNING, revolution=0.1)
    entry = {keys.SCAN_MOTION: motion.unsqueeze(0)}
    scan = observe(ranges, entry, angle_increment=-BEAM)
    assert off_the_walls(scan[keys.POINTS], scan[keys.RETURNS], pose) > 0.1


def test_blind_sector_of_a_partial_scan_moves():
    increment = math.radians(0.25)
    angles = {"angle_min": -math.radians(135.0), "angle_increment": increment}
    ranges, motion, pose = drive(
        TURNING, revolution=0.2, num_beams=1081, angles=tuple(angles.values())
    )
    pool = MinPool(bearing="beam", out_keys=[*MEASURED, "seen_measured"], **angles)
    names = [keys.POINTS_MEASURED, keys.RETURNS_MEASURED, keys.SCAN_MOTION, "seen_measured"]
    scan = observe(
        ranges, {keys.SCAN_MOTION: motion.unsqueeze(0)}, pool, num_beams=1081, in_keys=names,
        out_keys=[keys.POINTS, keys.RETURNS, keys.RANGES_POOLED, keys.SEEN], **angles,
    )  # fmt: skip
    assert off_the_walls(scan[keys.POINTS], scan[keys.RETURNS], pose) < 0.01
    seen, before = scan[keys.SEEN][0], scan["seen_measured"][0]
    # turned left by 0.4 rad since the first beam, at the right end of the sector
    gap = (~seen).nonzero().squeeze(-1)
    assert (gap.diff() == 1).all()
    assert (~before).nonzero().squeeze(-1)[-1] - gap[-1] == pytest.approx(0.4 * 90 / math.pi, abs=2)
    assert not scan[keys.RETURNS][0, ~seen].any()
    torch.testing.assert_close(
        scan[keys.RANGES_POOLED][0, ~seen], torch.full((len(gap),), 3.5), rtol=0, atol=0
    )


def test_commands_give_the_motion_of_a_held_command():
    ranges, motion, pose = drive(TURNING, age=0.1, revolution=0.1)
    command = {keys.COMMAND: TURNING.unsqueeze(0)}
    options = {"source": "commands", "age_s": 0.1, "revolution_s": 0.1}
    first, last = MotionCompensation(**options).frames(TURNING)
    torch.testing.assert_close(torch.stack([first, last]), motion)
    scan = observe(ranges, command, **options)
    assert off_the_walls(scan[keys.POINTS], scan[keys.RETURNS], pose) < 0.005


def test_no_motion_preserves_the_scan():
    ranges, motion, _ = drive(torch.zeros(2, dtype=torch.float64), walls=WALLS[:2])
    scan = observe(ranges, {keys.SCAN_MOTION: motion.unsqueeze(0)})
    for measured, key in zip(MEASURED, (keys.RANGES_POOLED, keys.POINTS, keys.RETURNS),
                             strict=True):  # fmt: skip
        torch.testing.assert_close(scan[key], scan[measured], rtol=1e-6, atol=1e-6)
    assert not scan[keys.RETURNS].all()


def test_rays_without_a_return_remain_free():
    """They stay at the maximum range of their bin, where the networks read "free"."""
    ranges, motion, _ = drive(TURNING, age=0.2, walls=WALLS[:1])
    scan = observe(ranges, {keys.SCAN_MOTION: motion.unsqueeze(0)})
    points, returns = scan[keys.POINTS][0], scan[keys.RETURNS][0]
    assert 20 < returns.sum() < 90
    angle = (torch.arange(180) * 8 + 3.5) * (2 * math.pi / 1440)
    free = 3.5 * torch.stack([angle.cos(), angle.sin()], dim=-1)
    torch.testing.assert_close(points[~returns], free[~returns])
    assert (scan[keys.RANGES_POOLED][0, ~returns] == 3.5).all()
    assert (points[returns].norm(dim=-1) < 3.5).all()
    torch.testing.assert_close(points.norm(dim=-1), scan[keys.RANGES_POOLED][0])


def test_return_that_moves_out_of_range_becomes_free():
    points = torch.tensor([[[3.45, 0.0], [0.0, 2.0], [-2.0, 0.0], [0.0, -2.0]]])
    back = torch.tensor([[[0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]])  # drove backwards
    moved, returns, ranges = MotionCompensation(group_size=1)(
        points_measured=points,
        returns_measured=torch.ones(1, 4, dtype=torch.bool),
        scan_motion=back,
    )
    assert returns.tolist() == [[False, True, True, True]]
    assert ranges[0, 0] == 3.5
    torch.testing.assert_close(moved[0, 0], torch.tensor([3.5, 0.0]))


def test_approached_wall_has_no_gaps():
    """Between the spread points of a wall 0.2 m ahead no ray reaches some bins."""
    walls = torch.tensor([[0.0, 0.0, 0.1, 3.0, 0.0]])
    start = torch.tensor([[-0.4, 0.0, 0.0]])
    ranges = cast_rays(start, walls.unsqueeze(0))[0]
    motion = torch.tensor([[[-0.2, 0.0, 0.0]] * 2])  # 0.1 m remain
    scan = observe(ranges, {keys.SCAN_MOTION: motion})
    ahead = torch.cat([scan[keys.RETURNS][0, :35], scan[keys.RETURNS][0, -35:]])
    assert ahead.all()
    points = scan[keys.POINTS][0][scan[keys.RETURNS][0]]
    assert points[:, 0].max() < 0.1 + 1e-3  # filled gaps too: never behind the wall
    near = points[:, 1].abs() < 0.3  # farther to the side neighbors are more than 0.4 m apart
    assert near.sum() > 10
    assert (points[near, 0] - 0.1).abs().max() < 1e-3


def test_points_are_ordered_by_bearing():
    ranges, motion, _ = drive(TURNING, age=0.2)
    points = observe(ranges, {keys.SCAN_MOTION: motion.unsqueeze(0)})[keys.POINTS][0]
    bearing = torch.atan2(points[:, 1], points[:, 0]).remainder(2 * math.pi)
    center = (torch.arange(180) * 8 + 3.5) * (2 * math.pi / 1440)
    assert se2.wrap_angle(bearing - center).abs().max() < 2.1 * math.pi / 180  # a gap's neighbor


def test_alignment_after_compensation_is_the_motion():
    """Scans 0.2 s old on a turn: frames t-1 and t, although the robot turned since."""
    steps = compose(
        pool=MinPool(bearing="beam", out_keys=MEASURED),
        compensation=MotionCompensation(),
        history=ScanHistory(),
        align=ICPAlign(initialization="rotation_search", metric="point_to_line", gate=0.3),
        ranges=RangeHistory(num_scans=1),
    )
    slow = torch.tensor([0.5, 0.5], dtype=torch.float64)
    before, after = drive(slow, age=0.2), drive(TURNING, age=0.2)

    def entry(scan):
        return {keys.RANGES: scan[0].unsqueeze(0), keys.SCAN_MOTION: scan[1].unsqueeze(0)}

    data = TensorDict({**entry(before), "next": TensorDict(entry(after), [1])}, [1])
    first = steps(data.exclude("next").clone())  # a reset
    data.update(first)
    moved = steps(data)["next"]
    expected = se2.relative(after[2], before[2]).float()
    assert expected[2].abs() > 0.25
    torch.testing.assert_close(moved[keys.ICP_TRANSFORM][0], expected, rtol=0, atol=0.005)
    now, past = moved[keys.RANGES_HISTORY][0]
    assert (now - past).abs().median() < 0.01
    torch.testing.assert_close(now, moved[keys.RANGES_POOLED][0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"source": "gps"}, "source='gps': must be one of"),
        ({"max_range": 0.0}, "max_range=0.0: must be"),
        ({"group_size": 0}, "group_size=0: must be"),
        ({"num_beams": 1}, "num_beams=1: must be"),
        ({"age_s": 0.1}, "age_s=0.1: must be 0 for source='motion'"),
        ({"source": "commands", "age_s": -0.1}, "age_s=-0.1: must be"),
        ({"source": "commands", "revolution_s": math.nan}, "revolution_s=nan: must be"),
        ({"mount": [0.0, 0.0]}, "mount=.* must be three"),
        ({"in_keys": ["a", "b"]}, "in_keys=.*must be 3 keys"),
    ],
)
def test_bad_argument_is_named(options, message):
    with pytest.raises(ValueError, match=message):
        MotionCompensation(**options)


@pytest.mark.parametrize(
    ("options", "key", "shape"),
    [({}, keys.SCAN_MOTION, "2, 3"), ({"source": "commands", "age_s": 0.1}, keys.COMMAND, "2")],
)
def test_motion_of_another_shape_is_named(options, key, shape):
    with pytest.raises(ValueError, match=rf"{key}: must have shape \[\*B, {shape}\]"):
        observe(torch.ones(1440), {key: torch.zeros(1, 4)}, **options)
