"""Classical controllers: geometry by hand, in the units that the environment undoes."""

import math
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from navrl import keys
from navrl.policies.classical import PurePursuit, StandStill, UniformRandom
from navrl.sim import DifferentialDrive

ROBOT = DifferentialDrive()
BACKWARDS = DifferentialDrive(min_speed=-0.25, max_speed=0.75, max_turn_rate=2.0)


def physical(policy, waypoints, robot):
    """The command (v, w) that ActionScaling makes of the policy's action."""
    points = torch.tensor(waypoints, dtype=torch.float32)
    action = policy(TensorDict({keys.WAYPOINTS: points}, points.shape[:-2]))[keys.ACTION]
    assert bool((action.abs() <= 1).all())
    low = torch.tensor([robot.min_speed, -robot.max_turn_rate])
    high = torch.tensor([robot.max_speed, robot.max_turn_rate])
    return low + (action + 1) / 2 * (high - low)


def test_drives_straight_at_a_waypoint_ahead():
    v, w = physical(PurePursuit(ROBOT, waypoint=0), [[0.6, 0.0]], ROBOT)
    assert v == pytest.approx(1.0)
    assert w == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("robot", [ROBOT, BACKWARDS])
@pytest.mark.parametrize("x, y", [(0.6, 0.2), (0.5, -0.3), (0.1, 0.5)])
def test_arc_passes_through_the_waypoint(x, y, robot):
    v, w = physical(PurePursuit(robot, waypoint=0), [[x, y]], robot)
    angle = 2 * math.atan2(y, x)  # turned at the waypoint: an arc turns by twice its chord's angle
    radius = float(v / w)
    end = radius * math.sin(angle), radius * (1 - math.cos(angle))
    assert end == pytest.approx((x, y), abs=1e-5)


def test_pursuit_slows_down_at_the_turn_rate_limit():
    v, w = physical(PurePursuit(ROBOT, waypoint=0), [[0.05, 0.2]], ROBOT)
    assert w == pytest.approx(math.pi, rel=1e-5)
    assert v < 0.5


@pytest.mark.parametrize("y, side", [(0.1, 1), (-0.1, -1), (0.0, 1)])
def test_pursuit_turns_in_place_towards_waypoints_behind(y, side):
    v, w = physical(PurePursuit(ROBOT, waypoint=0), [[-0.5, y]], ROBOT)
    assert v == pytest.approx(0.0, abs=1e-6)
    assert w == pytest.approx(side * math.pi, rel=1e-5)


def test_pursuit_follows_the_chosen_waypoint_in_any_batch():
    points = torch.zeros(2, 3, 5, 2)
    points[..., 3, :] = torch.tensor([0.4, -0.2])
    commands = physical(PurePursuit(ROBOT, waypoint=3), points.tolist(), ROBOT)
    single = physical(PurePursuit(ROBOT, waypoint=0), [[0.4, -0.2]], ROBOT)
    assert commands.shape == (2, 3, 2)
    torch.testing.assert_close(commands, single.expand(2, 3, 2))


def test_waypoint_that_does_not_exist_is_named():
    with pytest.raises(ValueError, match="waypoint=-1"):
        PurePursuit(ROBOT, waypoint=-1)
    with pytest.raises(ValueError, match="waypoint=2"):
        physical(PurePursuit(ROBOT, waypoint=2), [[0.1, 0.0], [0.2, 0.0]], ROBOT)


@pytest.mark.parametrize("robot", [ROBOT, BACKWARDS])
def test_stand_still_is_stationary_for_any_limits(robot):
    commands = physical(StandStill(robot), [[[0.6, 0.0]]] * 4, robot)
    torch.testing.assert_close(commands, torch.zeros(4, 2), atol=1e-6, rtol=0)
    with pytest.raises(ValueError, match="min_speed"):
        StandStill(DifferentialDrive(min_speed=0.1))


def test_random_fills_the_limits_and_repeats_with_its_seed():
    empty = TensorDict({}, [4000])
    first, second, other = (UniformRandom(seed=s)(empty.clone())[keys.ACTION] for s in (1, 1, 2))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)
    assert bool((first.abs() <= 1).all())
    assert first.mean(0).abs().max() < 0.05
    assert first.std(0).sub(1 / math.sqrt(3)).abs().max() < 0.03
    assert abs(torch.corrcoef(first.T)[0, 1]) < 0.06


def test_random_draws_differ_for_each_seed_and_scenario():
    def draws(seed, noise_seed):
        policy = UniformRandom(seed=seed)
        policy.prepare(SimpleNamespace(noise_seed=torch.tensor([noise_seed])))
        return tuple(policy(TensorDict({}, [1]))[keys.ACTION][0].tolist())

    pairs = [(seed, noise) for seed in range(3) for noise in range(3)]
    assert len({draws(*pair) for pair in pairs}) == len(pairs)
    assert draws(1, 2) == draws(1, 2)


def test_random_does_not_use_the_global_generator():
    torch.manual_seed(0)
    expected = torch.rand(3)
    torch.manual_seed(0)
    UniformRandom()(TensorDict({}, [7]))
    assert torch.equal(torch.rand(3), expected)
