"""A shield with a margin and a horizon of its own for points that move."""

import math

import pytest
import torch
from test_base_shield import random_scenes

from navrl.sim import DifferentialDrive, LimitedDrive
from navrl.transforms import ActionShield, Base

AHEAD = torch.tensor([[1.0, 0.0]])
RADIUS, MARGIN = 0.178, 0.03


def seen(point, velocity=(0.0, 0.0)):
    """One point and its velocity in m/s, as the inputs of a shield."""
    now, motion = torch.tensor([[point]]), 0.2 * torch.tensor([[velocity]])
    valid = torch.ones(1, 1, 2, dtype=torch.bool)
    return now, valid[..., 0], torch.cat([now - motion, now], dim=-1), valid


def passes(scene, command=AHEAD, **options):
    return torch.equal(ActionShield(**options).command(command, *scene), command)


@pytest.mark.parametrize("horizon", [0.4, 0.8])
def test_without_the_arguments_commands_are_bit_equal(horizon):
    action, *scene = random_scenes(300)
    slow = Base(LimitedDrive(1.0, 4.0), command_delays_s=(0.2, 0.3), scan_age_s=0.1)
    given = torch.rand(2, 300, 2, generator=torch.Generator().manual_seed(3))
    for base, state in ((None, ()), (slow, given)):
        options = {"horizon": horizon, "base": base}
        plain = ActionShield(**options)
        same = ActionShield(**options, moving_margin=MARGIN, moving_horizon=horizon)
        expected = plain.command(action, *scene, *state)
        assert (expected != action).any()
        assert torch.equal(same.command(action, *scene, *state), expected)
        assert same.times == plain.times


def test_approaching_points_need_the_moving_margin():
    """At 0.4 s the point is beside the robot, 0.1 m off the hull."""
    point, velocity = (0.4, RADIUS + 0.1 + 0.2), (0.0, -0.5)
    assert passes(seen(point, velocity))
    assert not passes(seen(point, velocity), moving_margin=0.2)
    there = (0.4, RADIUS + 0.1)
    assert passes(seen(there), moving_margin=0.2)  # static
    leaving = (0.5, 0.0)  # ahead of the robot, faster than it
    assert passes(seen((RADIUS + 0.1, 0.0), (1.2, 0.0)), moving_margin=0.2)
    assert passes(seen(leaving, (1.2, 0.0)), moving_margin=0.2)


def test_moving_margin_may_be_less_than_the_margin():
    point, velocity = (0.4, RADIUS + 0.1 + 0.2), (0.0, -0.5)
    assert not passes(seen(point, velocity), margin=0.15)
    assert passes(seen(point, velocity), margin=0.15, moving_margin=0.05)


def test_moving_points_are_checked_up_to_their_horizon():
    """The robot meets the pedestrian after 1 s, and a wall after 0.8 s."""
    pedestrian, wall = seen((2.0 + RADIUS, 0.0), (-1.0, 0.0)), seen((0.8 + RADIUS, 0.0))
    assert passes(pedestrian) and passes(wall)
    assert passes(pedestrian, moving_horizon=0.9)
    assert not passes(pedestrian, moving_horizon=1.2)
    assert passes(wall, moving_horizon=1.2)
    assert not passes(wall, horizon=1.2)


def test_leaving_points_are_checked_up_to_the_moving_horizon():
    """The robot is 0.6 m/s faster than the point, 0.5 m off the hull."""
    slow = seen((0.5 + RADIUS, 0.0), (0.4, 0.0))
    assert passes(slow) and not passes(slow, moving_horizon=1.2)


def test_time_of_contact_counts_walls_up_to_the_horizon():
    """Nothing evades the pedestrian; a wall that is met after the horizon delays no command."""
    walker, _, flow, valid = seen((0.0, RADIUS + 0.05), (0.0, -1.4))
    walls = torch.tensor([[[0.8, y] for y in torch.linspace(-1.0, 1.0, 21).tolist()]])
    static, sure = torch.cat([walls, walls], -1), torch.ones(1, 21, 2, dtype=torch.bool)
    points, flow = torch.cat([walker, walls], 1), torch.cat([flow, static], 1)
    valid = torch.cat([valid, sure], 1)
    shield = ActionShield(horizon=0.2, moving_horizon=1.2, group_radius=0.05, moving_margin=0.3)
    command = shield.command(AHEAD, points, valid[..., 0], flow, valid)
    alone = shield.command(AHEAD, walker, valid[:, :1, 0], flow[:, :1], valid[:, :1])
    assert torch.equal(command, alone)


def test_delays_shift_both_horizons():
    """A command takes effect after 0.4 s; what applies until then stops the robot."""
    wall, stop = seen((0.5 + RADIUS, 0.0)), torch.zeros(1, 2)
    late = Base(DifferentialDrive(), command_delays_s=(0.4, 0.4))
    options = {"base": late, "base_keys": ["velocity", "first", "second"], "moving_horizon": 1.2}
    shield = ActionShield(**options)
    assert shield._times(late)[-1] == pytest.approx(1.6)
    assert torch.equal(shield.command(AHEAD, *wall, stop, stop, stop), AHEAD)
    near = seen((0.38 + RADIUS, 0.0))
    assert not torch.equal(shield.command(AHEAD, *near, stop, stop, stop), AHEAD)
    pedestrian = seen((1.9 + RADIUS, 0.0), (-0.5, 0.0))
    assert not torch.equal(shield.command(AHEAD, *pedestrian, stop, stop, stop), AHEAD)
    at_once = ActionShield(moving_horizon=1.2)
    assert torch.equal(at_once.command(AHEAD, *pedestrian), AHEAD)


def test_horizon_of_moving_points_is_rounded_up():
    assert ActionShield(moving_horizon=1.1).times == pytest.approx([0.1 * k for k in range(1, 12)])
    assert len(ActionShield(moving_horizon=1.11).times) == 12


@pytest.mark.parametrize(
    "options, message",
    [
        ({"moving_margin": -0.1}, "moving_margin=-0.1: must be >= 0"),
        ({"moving_margin": math.nan}, "moving_margin=nan: must be >= 0"),
        ({"moving_horizon": 0.3}, r"moving_horizon=0.3: must be at least horizon=0.4 \(s\)"),
        ({"moving_horizon": math.nan}, "moving_horizon=nan: must be at least horizon"),
        ({"moving_horizon": math.inf}, "moving_horizon=inf: must be at least horizon"),
        ({"moving_horizon": 20.0}, "moving_horizon=20.0, horizon=0.4: must be at most 100 times"),
        ({"horizon": 1e-300, "moving_horizon": 1.0}, "must be at most 100 times"),
        ({"horizon": 20.0}, "horizon=20.0, time_step=0.2, checks_per_step=2: must be at most 100"),
    ],
)
def test_bad_values_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        ActionShield(**options)
