"""A robot that has stalled is detected and driven on; others keep their commands."""

import math

import pytest
import torch
from contract import TransformContract
from tensordict import TensorDict

from navrl import keys
from navrl.transforms import ActionShield, Recovery, StallTimer, Waypoints, compose
from navrl.transforms.stall_timer import has_stalled

NOBODY = torch.zeros(1, 1, 4), torch.zeros(1, 1, 2, dtype=torch.bool)
ASKED = torch.tensor([[0.7, -0.4]])


def times(progress, **options):
    """Return largest progress and time at each step."""
    timer = StallTimer(**options)
    steps = [TensorDict({keys.PATH_PROGRESS: torch.tensor([[value]])}, [1]) for value in progress]
    timer(steps[0])
    for before, after in zip(steps[:-1], steps[1:], strict=True):
        timer._step(before, after)
    return [tuple(round(value, 4) for value in step[keys.STALL][0].tolist()) for step in steps]


class TestStallTimer(TransformContract):
    is_memoryless = False
    state_keys = (keys.STALL,)

    def make(self, **kwargs):
        return StallTimer(**kwargs)

    def before(self):
        return [Waypoints()]

    def in_foreign_env(self):
        waypoints = Waypoints(in_keys=["odometry", "route"], out_keys=["xy", ["ahead", "arc"]])
        return [waypoints, StallTimer(in_keys=[["ahead", "arc"]], out_keys=[["ahead", "stall"]])]

    def check_rollout(self, rollout):
        best, since = rollout["next", keys.STALL].unbind(-1)
        assert (best >= rollout["next", keys.PATH_PROGRESS].squeeze(-1) - 0.5 - 1e-5).all()
        earlier = rollout[keys.STALL][..., 1]
        assert ((since == 0.0) | ((since - earlier - 0.2).abs() < 1e-5)).all()


def test_time_restarts_with_progress():
    assert times([1.0, 1.04, 1.06, 1.0, 1.2]) == [
        (1.0, 0.0),
        (1.0, 0.2),  # 4 cm are not enough
        (1.06, 0.0),
        (1.06, 0.2),  # going back counts as no progress
        (1.2, 0.0),
    ]


def test_stalled_robot_needs_more_progress():
    seen = times([0.0, 0.0, 0.0, 0.3, 0.45, 0.5], patience=0.4)
    assert [time for _, time in seen] == [0.0, 0.2, 0.4, 0.6, 0.8, 0.0]


@pytest.mark.parametrize(("since", "expected"), [(1.8, False), (1.9999999, True), (2.4, True)])
def test_patience_is_counted_in_whole_steps(since, expected):
    assert has_stalled(torch.tensor([since]), 2.0, 0.2).item() is expected


def freed(points, waypoint, since=2.0, **options):
    points = torch.tensor([points])
    seen = points, torch.ones(points.shape[:2], dtype=torch.bool)
    waypoints = torch.tensor([[waypoint, waypoint]])
    stall = torch.tensor([[1.0, since]])
    command = Recovery(**options).command(ASKED, *seen, *NOBODY, waypoints, stall)
    return command[0].tolist()


def test_robots_that_make_progress_keep_their_command():
    assert freed([(0.5, 0.0)], (1.0, 0.0), since=1.8) == ASKED[0].tolist()


@pytest.mark.parametrize("bearing", [0.6, -2.0, 3.0])
def test_stalled_robot_turns_to_the_path_in_place(bearing):
    speed, turn_rate = freed([(3.0, 3.0)], (math.cos(bearing), math.sin(bearing)))
    assert speed == 0.0
    assert turn_rate == pytest.approx(max(-math.pi, min(math.pi, bearing / 0.2)), abs=1e-5)


def test_stalled_robot_drives_to_the_path_and_around_a_point():
    assert freed([(3.0, 3.0)], (1.5, 0.0)) == [0.5, 0.0]
    speed, turn_rate = freed([(0.45, 0.05)], (1.5, 0.0))
    assert speed > 0.0
    assert turn_rate < 0.0  # away from the point on the left


def test_robot_that_may_reverse_leaves_a_dead_end():
    walls = [(0.2, y / 20) for y in range(-10, 11)] + [
        (x / 20, side) for x in range(-8, 5) for side in (-0.22, 0.22)
    ]
    goal = (0.8, 0.0)
    assert freed(walls, goal)[0] == 0.0
    assert freed(walls, goal, min_speed=-0.3)[0] <= 0.0


def test_approaching_pedestrian_is_predicted():
    person = torch.tensor([[[1.0, 0.0]]]), torch.tensor([[True]])
    approach = torch.tensor([[[1.2, 0.0, 1.0, 0.0]]]), torch.ones(1, 1, 2, dtype=torch.bool)
    waypoints, stall = torch.tensor([[[0.6, 0.0]]]), torch.tensor([[1.0, 2.0]])
    recovery = Recovery()
    toward = recovery.command(ASKED, *person, *approach, waypoints, stall)
    static = recovery.command(ASKED, *person, *NOBODY, waypoints, stall)
    assert static[0].tolist() == pytest.approx([0.4, 0.0])  # 0.6 m in 1.4 s
    assert abs(toward[0, 1]) > 0.1


def test_rows_and_batch_shapes_are_independent():
    points = torch.rand(2, 3, 20, 2, generator=torch.Generator().manual_seed(0)) * 4 - 2
    returns = torch.ones(2, 3, 20, dtype=torch.bool)
    nobody = torch.zeros(2, 3, 1, 4), torch.zeros(2, 3, 1, 2, dtype=torch.bool)
    waypoints, action = torch.tensor([0.5, 0.1]).expand(2, 3, 5, 2), ASKED.expand(2, 3, 2)
    stall = torch.tensor([[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]]).expand(2, 3, 2)
    recovery = Recovery()
    together = recovery.command(action, points, returns, *nobody, waypoints, stall)
    assert torch.equal(together[:, 0], action[:, 0])
    alone = recovery.command(
        action[1, 2],
        *(value[1, 2] for value in (points, returns, *nobody, waypoints, stall)),
    )
    torch.testing.assert_close(together[1, 2], alone)


def test_shield_checks_the_command_of_a_recovery():
    shield, recovery = ActionShield(), Recovery()
    steps = list(compose(recovery=recovery, action_shield=shield, stall=StallTimer()))
    assert steps.index(shield) < steps.index(recovery)  # the first step is the last to act


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StallTimer(patience=0.0), "patience=0"),
        (lambda: StallTimer(out_keys=["a", "b"]), "must be one each"),
        (lambda: Recovery(facing=-1.0), "facing=-1"),
        (lambda: Recovery(max_speed=0.0), "must satisfy min_speed < max_speed"),
        (lambda: Recovery(min_descriptor_speed=2.0), "min_descriptor_speed=2.0"),
        (lambda: Recovery(scan_keys=["points"]), "must be 6 keys"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
