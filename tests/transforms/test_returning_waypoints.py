"""Waypoints lead back along the trail while the path is out of sight, and else along the path."""

import pytest
import torch
from contract import TransformContract
from tensordict import TensorDict
from torchrl.envs import Compose

from navrl import keys
from navrl.ops import se2
from navrl.ops.sight import is_hidden
from navrl.transforms import MinPool, ReturningWaypoints, Waypoints

BEND = torch.tensor([[[0.0, 0.0], [2.0, 0.0], [2.0, 4.0]]])  # m, a robot that misses it drives on
FAR = torch.tensor([[[3.0, 3.0]]])


class TestReturningWaypoints(TransformContract):
    is_memoryless = False
    state_keys = (keys.PATH_PROGRESS, keys.TRAIL, keys.TRAIL_STATE)

    def make(self, **kwargs):
        return ReturningWaypoints(num_trail_points=8, **kwargs)

    def before(self):
        return [MinPool(group_size=4)]

    def in_foreign_env(self):
        pool = MinPool(3, 2.5, in_keys=["laser"], out_keys=["r", "xy", "hit"])
        way = [["ahead", "xy"], ["ahead", "arc"], ["ahead", "trail"], ["ahead", "state"]]
        inputs = ["odometry", "route", "xy", "hit"]
        return [pool, ReturningWaypoints(in_keys=inputs, out_keys=way)]

    def check_rollout(self, rollout):
        onward = Waypoints()(rollout.select(keys.POSE, keys.PATH, keys.PATH_PROGRESS))
        count, time = rollout[keys.TRAIL_STATE].unbind(-1)
        in_sight = (time < 0.5) | (count < 1.5)
        assert in_sight.any()
        torch.testing.assert_close(
            rollout[keys.WAYPOINTS][in_sight], onward[keys.WAYPOINTS][in_sight]
        )


BEYOND = torch.tensor([[2.0, 0.3 * index] for index in range(1, 6)])  # m, waypoints at the bend


def seen(position, num_hidden, path=BEND, yaw=0.0):
    """Return an observation in which returns hide the first waypoints beyond the bend."""
    pose = torch.tensor([[*position, yaw]], dtype=path.dtype)
    ahead = (BEYOND + path[0, 0]).unsqueeze(0)
    points = 0.5 * se2.transform_points(se2.inverse(pose), ahead).float()
    returns = torch.arange(5).unsqueeze(0) < num_hidden
    return TensorDict(pose=pose, path=path, points=points, returns=returns, batch_size=[1])


def drive(steps, transform=None):
    """Return the observations of a drive along ``(x, num_hidden)`` on the line y = 0."""
    transform = transform or ReturningWaypoints()
    before, observations = transform(seen((0.0, 0.0), 0)), []
    for x, num_hidden in steps:
        now = seen((x, 0.0), num_hidden)
        transform._step(before, now)
        observations.append(now)
        before = now
    return observations


def first_waypoint(observation):
    """Return the first waypoint in the world frame, m."""
    points = se2.transform_points(observation[keys.POSE], observation[keys.WAYPOINTS])
    return [round(value, 3) for value in points[0, 0].tolist()]


PAST_THE_BEND = [(x / 10, 5 * (x > 22)) for x in range(2, 53, 2)]  # 0.2 m a step to x = 5.2 m


@pytest.mark.parametrize("num_hidden", [0, 4])
def test_waypoints_follow_the_path_while_it_is_in_sight(num_hidden):
    last = drive([(x, num_hidden) for x, _ in PAST_THE_BEND])[-1]
    assert first_waypoint(last) == [2.0, 0.3]
    assert last[keys.TRAIL_STATE].tolist() == [[1.0, 0.0]]


def test_waypoints_lead_back_once_the_path_is_hidden():
    driven = drive(PAST_THE_BEND)
    sides = [first_waypoint(step)[1] for step in driven[12:]]  # from 2.6 m: min_distance is 0.7 m
    assert sides[:4] == [0.3, 0.3, 0.3, 0.0]  # a patience of 0.6 s
    assert first_waypoint(driven[-1]) == [pytest.approx(4.9), 0.0]
    way = se2.transform_points(driven[-1][keys.POSE], driven[-1][keys.WAYPOINTS])[0]
    torch.testing.assert_close(way[:, 1], torch.zeros(5), rtol=0.0, atol=1e-5)


def test_way_back_ends_at_the_path():
    back = [(x / 10, 5) for x in range(50, 22, -2)]
    driven = drive([*PAST_THE_BEND, *back])[len(PAST_THE_BEND) :]
    counts = [step[keys.TRAIL_STATE][0, 0].item() for step in driven]
    assert counts == sorted(counts, reverse=True)
    assert len(set(counts)) > 5  # reached points are removed on the way
    for step in driven[:-3]:  # then the first point is reached
        assert first_waypoint(step) == [pytest.approx(step[keys.POSE][0, 0].item() - 0.3), 0.0]
    assert counts[-1] == 1.0
    assert first_waypoint(driven[-1]) == [2.0, 0.3]


def test_way_back_starts_after_the_point_that_is_reached():
    past = [(x / 10, 5 * (x > 24)) for x in range(3, 52, 3)]  # points of the trail at 4.2 and 4.8 m
    last = drive([*past, (4.95, 5), (4.65, 5)])[-1]
    assert first_waypoint(last) == [pytest.approx(4.35), 0.0]


def test_robot_where_the_path_was_last_seen_does_not_turn_back():
    last = drive([(2.8, 0), (3.0, 0), *[(3.2, 5)] * 5])[-1]
    assert last[keys.TRAIL_STATE][0].tolist() == pytest.approx([1.0, 1.0])
    assert first_waypoint(last) == [2.0, 0.3]


def test_waypoints_follow_the_path_as_soon_as_it_is_seen_again():
    last = drive([*PAST_THE_BEND, (5.0, 0)])[-1]
    assert first_waypoint(last) == [2.0, 0.3]
    assert last[keys.TRAIL_STATE].tolist() == [[1.0, 0.0]]


def test_way_back_is_exact_far_from_the_origin():
    shift = torch.tensor([5.0e5, 5.6e6], dtype=torch.float64)
    far = BEND.double() + shift
    transform = ReturningWaypoints()
    before = transform(seen(shift.tolist(), 0, far))
    for x, num_hidden in PAST_THE_BEND:
        now = seen((shift[0].item() + x, shift[1].item()), num_hidden, far, yaw=1.2)
        transform._step(before, now)
        before = now
    way = se2.transform_points(torch.tensor([[0.0, 0.0, 1.2]]), now[keys.WAYPOINTS])[0]
    near = drive(PAST_THE_BEND)[-1][keys.WAYPOINTS][0]
    torch.testing.assert_close(way, near, rtol=0.0, atol=1e-4)


def test_full_trail_does_not_grow():
    last = drive(PAST_THE_BEND, ReturningWaypoints(num_trail_points=2))[-1]
    assert last[keys.TRAIL_STATE][0, 0].item() == 2.0


def test_restart_clears_the_trail():
    last = drive(PAST_THE_BEND)[-1]
    transform = ReturningWaypoints()
    transform.restart(last, torch.tensor([[1.0]]))
    now = seen((5.2, 0.0), 5)
    transform._step(last, now)
    assert now[keys.TRAIL_STATE][0].tolist() == pytest.approx([1.0, 0.2])


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((1.0, 0.05), True),
        ((1.0, 0.15), False),  # beside the line
        ((1.95, 0.0), False),  # at the target
        ((2.5, 0.0), False),  # behind it
        ((-1.0, 0.0), False),  # behind the sensor
    ],
)
def test_only_a_return_on_the_line_hides_a_point(point, expected):
    arguments = torch.tensor([2.0, 0.0]), torch.tensor([point])
    assert is_hidden(*arguments, torch.tensor([True])).item() is expected
    assert not is_hidden(*arguments, torch.tensor([False])).item()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ReturningWaypoints(patience=0.0), "patience=0"),
        (lambda: ReturningWaypoints(reach=-1.0), "reach=-1"),
        (lambda: ReturningWaypoints(num_trail_points=0), "num_trail_points=0"),
        (lambda: ReturningWaypoints(in_keys=["a", "b", "c"]), "must be 4 keys"),
        (lambda: is_hidden(torch.zeros(3), FAR, torch.ones(1, 1)), "must have shapes"),
    ],
)
def test_invalid_values_raise(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_two_keys_are_completed():
    transform = ReturningWaypoints(in_keys=["pose_ahead", "path"])
    assert transform.in_keys == ["pose_ahead", keys.PATH, keys.POINTS, keys.RETURNS]
    assert isinstance(Compose(transform)[0], Waypoints)
