"""Groups of moving returns that are followed through past scans."""

import math

import pytest
import torch

from navrl.ops.gait import foot_center, step_length
from navrl.ops.motion import FAR
from navrl.ops.tracking import track_groups

STEP = 0.2  # s
SCANS = 6  # the present one and five past ones


def disc(x, y, radius=0.07):
    """Return 8 points on a circle, ``[8, 2]`` m."""
    bearing = torch.arange(8) * (math.pi / 4.0)
    around = torch.stack([bearing.cos(), bearing.sin()], dim=-1)
    return torch.tensor([x, y]) + radius * around


def tracks(scans, moving=None, **kwargs):
    """Return the tracks of scans t to t-K, each of ``[N, 2]`` m."""
    now, *past = scans
    moving = torch.ones(now.shape[:-1], dtype=torch.bool) if moving is None else moving
    return track_groups(now, moving, torch.stack(past), **kwargs)


def speed_at(result, x, y, reach=0.4):
    """Return the mean velocity of the valid tracks near a place ``[2]`` m/s and their number."""
    before, now = result.tagd.split(2, dim=-1)
    near = (now - torch.tensor([x, y])).norm(dim=-1) < reach
    near &= result.valid.all(-1)
    return (now - before)[near].mean(0) / STEP, int(near.sum())


@pytest.mark.parametrize("velocity", [(0.5, 0.0), (-1.2, 0.6), (0.0, -2.0)])
def test_velocity_of_a_walking_disc_is_exact(velocity):
    x, y = velocity
    scans = [disc(1.5 - x * STEP * k, 0.5 - y * STEP * k) for k in range(SCANS)]
    result = tracks(scans)
    found, count = speed_at(result, 1.5, 0.5, reach=1e-4)
    assert count > 0 and result.tagd.dtype == torch.float32
    torch.testing.assert_close(found, torch.tensor(velocity), atol=1e-4, rtol=0.0)
    assert torch.equal(result.valid[:, 0], result.valid[:, 1])


@pytest.mark.parametrize("speed", [0.6, 1.0, 1.2])
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.6, 0.9])
def test_legs_that_stand_and_swing_have_the_speed_of_the_body(speed, phase):
    length = step_length(speed)

    def legs(k):
        time = -k * STEP
        feet = [
            foot_center(1.5 + speed * time, 0.4, 1.0, 0.0, phase + speed * time / length, length, s)
            for s in (0, 1)
        ]
        return torch.cat([disc(*foot) for foot in feet])

    found, count = speed_at(tracks([legs(k) for k in range(SCANS)]), 1.5, 0.4, reach=0.6)
    assert count > 0
    assert (found - torch.tensor([speed, 0.0])).norm() < 0.3


def test_passing_pedestrians_have_tracks_of_their_own():
    scans = [torch.cat([disc(1.5 - 0.2 * k, 0.5), disc(1.5 + 0.2 * k, -0.5)]) for k in range(SCANS)]
    result = tracks(scans)
    for y, velocity in ((0.5, 1.0), (-0.5, -1.0)):
        found, count = speed_at(result, 1.5, y)
        assert count > 0
        torch.testing.assert_close(found, torch.tensor([velocity, 0.0]), atol=1e-4, rtol=0.0)


def test_static_returns_have_no_track():
    scans = [torch.cat([disc(1.5, 0.5), disc(1.0, -0.5 - 0.2 * k)]) for k in range(SCANS)]
    moving = torch.arange(16) >= 8
    past = [torch.where(moving[:, None], scan, FAR) for scan in scans[1:]]
    result = tracks([scans[0], *past], moving)
    assert speed_at(result, 1.5, 0.5)[1] == 0 and speed_at(result, 1.0, -0.5)[1] > 0
    still = tracks([scans[0], *past], torch.zeros(16, dtype=torch.bool))
    assert not still.valid.any() and torch.equal(still.tagd[:, :2], still.tagd[:, 2:])


def test_track_begins_with_the_second_scan():
    """In the first scan there is a position, in the second one a velocity."""
    scans = [disc(1.5 - 0.2 * k, 0.0) for k in range(SCANS)]
    nothing = torch.full_like(scans[0], FAR)
    alone = tracks([scans[0], *[nothing] * 5])
    assert alone.valid[:, 1].any() and not alone.valid[:, 0].any()
    assert torch.equal(alone.tagd[:, :2], alone.tagd[:, 2:])
    found, count = speed_at(tracks([*scans[:2], *[nothing] * 4]), 1.5, 0.0)
    assert count > 0
    torch.testing.assert_close(found, torch.tensor([1.0, 0.0]), atol=1e-4, rtol=0.0)
    # A gap ends it: what is seen before is not known to be the same.
    found, _ = speed_at(tracks([*scans[:2], nothing, *[scans[0]] * 3]), 1.5, 0.0)
    torch.testing.assert_close(found, torch.tensor([1.0, 0.0]), atol=1e-4, rtol=0.0)


@pytest.mark.parametrize("gate, count", [(0.5, 0), (0.7, 1)])
def test_nearest_return_within_the_gate_continues(gate, count):
    """A point that moves 0.65 m in the first step, more than the radius."""
    now, *past = [torch.tensor([[2.0 - 0.65 * k, 0.0]]) for k in range(3)]
    result = tracks([now, *past], radius=0.3, gate=gate)
    found = speed_at(result, 2.0, 0.0)
    assert found[1] == count
    if count:
        torch.testing.assert_close(found[0], torch.tensor([3.25, 0.0]), atol=1e-4, rtol=0.0)


@pytest.mark.parametrize("max_rms, valid", [(0.05, False), (0.2, True)])
def test_positions_off_a_line_are_no_motion(max_rms, valid):
    """To and from 0.2 m: the RMS distance to the line is 0.1 m or a little less."""
    scans = [torch.tensor([[1.0, 0.2 * (k % 2)]]) for k in range(SCANS)]
    result = tracks(scans, max_rms=max_rms)
    assert bool(result.valid[:, 0].any()) is valid and result.valid[:, 1].any()


def test_bad_points_are_ignored_and_outputs_finite():
    scans = [disc(1.5 - 0.2 * k, 0.0) for k in range(SCANS)]
    expected = tracks(scans)
    bad = torch.tensor([[math.nan, 0.0], [math.inf, 1.0], [FAR, FAR], [-FAR, 1.0]])
    result = tracks([torch.cat([scan, bad]) for scan in scans])
    assert torch.equal(result.valid, expected.valid)
    torch.testing.assert_close(result.tagd, expected.tagd)
    none = tracks([torch.full((3, 2), math.nan)] * SCANS)
    assert none.tagd.isfinite().all() and not none.valid.any()


def test_any_batch_shape():
    torch.manual_seed(0)
    points, past = 2.0 * torch.randn(2, 3, 20, 2), 2.0 * torch.randn(2, 3, 5, 20, 2)
    moving = torch.rand(2, 3, 20) < 0.5
    whole = track_groups(points, moving, past)
    assert whole.tagd.shape == (2, 3, 30, 4) and whole.valid.shape == (2, 3, 30, 2)
    single = track_groups(points[1, 2], moving[1, 2], past[1, 2])
    torch.testing.assert_close(single.tagd, whole.tagd[1, 2])
    assert torch.equal(single.valid, whole.valid[1, 2])


@pytest.mark.parametrize(
    "kwargs, message",
    [
        ({"num_groups": 0}, "num_groups=0: must be an integer"),
        ({"num_groups": 3601}, "num_groups=3601: must be at most 3600"),
        ({"radius": 0.0}, r"radius=0\.0: must be positive"),
        ({"max_rms": math.nan}, "max_rms=nan: must be positive"),
        ({"max_range": -1.0}, r"max_range=-1\.0: must be positive"),
        ({"gate": 0.5}, r"gate=0\.5: must be at least radius=0\.6"),
    ],
)
def test_bad_options_are_named(kwargs, message):
    with pytest.raises(ValueError, match=message):
        tracks([disc(1.0, 0.0)] * 2, **kwargs)


def test_bad_shapes_are_named():
    points, moving, past = torch.zeros(4, 2), torch.ones(4, dtype=torch.bool), torch.zeros(5, 4, 2)
    with pytest.raises(ValueError, match="points: must have shape"):
        track_groups(torch.zeros(4, 3), moving, past)
    with pytest.raises(ValueError, match="moving: must be bool of shape"):
        track_groups(points, moving.float(), past)
    for wrong in (past[:, :3], past[:0], past[0], past[None]):
        with pytest.raises(ValueError, match="past: must have shape"):
            track_groups(points, moving, wrong)
