"""The drive: exact arcs, limits, and three forms that are the same."""

import math

import pytest
import torch

from navrl.sim import DifferentialDrive


def advance_tensor(robot, pose, velocity, command, duration):
    pose, velocity = robot.advance(
        *(torch.tensor(value, dtype=torch.float64) for value in (pose, velocity, command)), duration
    )
    return pose.tolist(), velocity.tolist()


ADVANCES = [advance_tensor, lambda robot, *arguments: robot.advance_one(*arguments)]


@pytest.mark.parametrize("advance", ADVANCES)
def test_kinematic_drives_a_circle(advance):
    """Quarter of a circle of radius v / w to the left, from the origin along x."""
    pose, velocity = advance(
        DifferentialDrive(), (0.0, 0.0, 0.0), (0.0, 0.0), (0.5, 1.0), math.pi / 2
    )
    assert pose == pytest.approx([0.5, 0.5, math.pi / 2], abs=1e-12)
    assert velocity == pytest.approx([0.5, 1.0])


@pytest.mark.parametrize("advance", ADVANCES)
@pytest.mark.parametrize("w", [0.0, 1e-9, 1e-5, -1e-4, 2e-4])
def test_nearly_straight_arc_is_exact(advance, w):
    robot, pose, velocity = DifferentialDrive(), (1.0, 2.0, 0.5), (0.0, 0.0)
    end, _ = advance(robot, pose, velocity, (1.0, w), 1.0)
    # the arc by its series, good to w^3
    along, across = 1.0 - w * w / 6.0, w / 2.0
    assert end[0] == pytest.approx(1.0 + along * math.cos(0.5) - across * math.sin(0.5), abs=1e-11)
    assert end[1] == pytest.approx(2.0 + along * math.sin(0.5) + across * math.cos(0.5), abs=1e-11)


@pytest.mark.parametrize("advance", ADVANCES)
def test_yaw_stays_within_one_turn(advance):
    robot = DifferentialDrive()
    end, _ = advance(robot, (0.0, 0.0, 3.0), (0.0, 0.0), (0.0, 1.0), 1.0)
    assert end[2] == pytest.approx(4.0 - 2 * math.pi)
    end, _ = advance(robot, (0.0, 0.0, -3.0), (0.0, 0.0), (0.0, -1.0), 1.0)
    assert end[2] == pytest.approx(2 * math.pi - 4.0)


@pytest.mark.parametrize("advance", ADVANCES)
@pytest.mark.parametrize("yaw", [math.pi, -math.pi])
def test_half_a_turn_is_pi_not_minus_pi(advance, yaw):
    end, _ = advance(DifferentialDrive(), (0.0, 0.0, yaw), (0.0, 0.0), (0.0, 0.0), 1.0)
    assert end[2] == math.pi


@pytest.mark.parametrize("advance", ADVANCES)
@pytest.mark.parametrize("w", [20.0, -20.0])
def test_several_revolutions_end_on_the_circle(advance, w):
    """Three turns and a bit of radius v / w; the yaw loses whole turns."""
    robot = DifferentialDrive(max_turn_rate=30.0)
    end, _ = advance(robot, (0.0, 0.0, 0.0), (0.0, 0.0), (1.0, w), 1.0)
    expected = [math.sin(w) / w, (1 - math.cos(w)) / w, w - math.copysign(6 * math.pi, w)]
    assert end == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("advance", ADVANCES)
def test_commands_are_clipped(advance):
    robot = DifferentialDrive(max_speed=0.7, max_turn_rate=1.0)
    _, velocity = advance(robot, (0.0, 0.0, 0.0), (0.0, 0.0), (3.0, -9.0), 0.1)
    assert velocity == pytest.approx([0.7, -1.0])
    _, velocity = advance(robot, (0.0, 0.0, 0.0), (0.0, 0.0), (-3.0, 9.0), 0.1)
    assert velocity == pytest.approx([0.0, 1.0])


@pytest.mark.parametrize("advance", ADVANCES)
def test_wheels_have_limited_acceleration(advance):
    """From rest to (0.5, 2) at 1 m/s^2: the right wheel wants 0.73 m/s, the left 0.27 m/s."""
    robot = DifferentialDrive(model="wheeled", wheel_acceleration=1.0)
    velocity = (0.0, 0.0)
    expected = [(0.2, 0.2), (0.27, 0.4), (0.27, 0.6), (0.27, 0.73), (0.27, 0.73)]
    for left, right in expected:
        _, velocity = advance(robot, (0.0, 0.0, 0.0), velocity, (0.5, 2.0), 0.2)
        assert velocity == pytest.approx([(left + right) / 2, (right - left) / 0.23])
    for left, right in [(0.07, 0.53), (0.0, 0.33), (0.0, 0.13), (0.0, 0.0)]:
        _, velocity = advance(robot, (0.0, 0.0, 0.0), velocity, (0.0, 0.0), 0.2)
        assert velocity == pytest.approx([(left + right) / 2, (right - left) / 0.23], abs=1e-12)


@pytest.mark.parametrize("model", ["kinematic", "wheeled"])
def test_single_and_batched_robots_move_equally(model):
    robot = DifferentialDrive(model=model)
    generator = torch.Generator().manual_seed(0)
    pose = torch.randn(32, 3, generator=generator, dtype=torch.float64)
    velocity = torch.rand(32, 2, generator=generator, dtype=torch.float64)
    poses = [tuple(row) for row in pose.tolist()]
    velocities = [tuple(row) for row in velocity.tolist()]
    for _ in range(20):
        command = 4 * torch.rand(32, 2, generator=generator, dtype=torch.float64) - 1
        pose, velocity = robot.advance(pose, velocity, command, 0.02)
        ends = [
            robot.advance_one(*state, tuple(row), 0.02)
            for *state, row in zip(poses, velocities, command.tolist(), strict=True)
        ]
        poses, velocities = [end[0] for end in ends], [end[1] for end in ends]
    assert (pose - torch.tensor(poses, dtype=torch.float64)).abs().max() < 1e-12


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("radius", 0.0),
        ("wheel_separation", -0.23),
        ("max_speed", math.inf),
        ("max_turn_rate", math.nan),
        ("min_speed", 1.0),
        ("model", "tank"),
        ("wheel_acceleration", 0.0),
    ],
)
def test_bad_parameters_are_named(name, value):
    with pytest.raises(ValueError, match=name):
        DifferentialDrive(**{name: value})
