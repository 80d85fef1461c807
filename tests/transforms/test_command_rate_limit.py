"""Commands that a base can follow within a step, and the drive that they leave unchanged."""

import pytest
import torch
from scenes import pack, scene

from navrl.sim import BatchedSimulator, DifferentialDrive, Lidar, LimitedDrive
from navrl.transforms import ActionShield, Base, CommandRateLimit, Normalize, SubgoalAction, compose

KOBUKI = LimitedDrive(
    linear_acceleration=0.5,
    linear_deceleration=0.6,
    angular_acceleration=3.5,
    angular_deceleration=4.2,
)


def limited(robot, command, last):
    limit = CommandRateLimit(base=Base(robot))
    return limit.command(torch.tensor([command]), torch.tensor([last]))[0].tolist()


@pytest.mark.parametrize(
    ("command", "last", "expected"),
    [
        ((1.0, 0.0), (0.2, 0.0), (0.3, 0.0)),  # 0.5 m/s^2 for 0.2 s
        ((0.0, 0.0), (0.5, 0.0), (0.38, 0.0)),  # 0.6 m/s^2 down
        ((0.5, 3.0), (0.5, 1.0), (0.5, 1.7)),  # 3.5 rad/s^2
        ((0.5, -3.0), (0.5, 1.0), (0.5, 0.16)),  # 4.2 rad/s^2 down
        ((0.25, 0.1), (0.2, 0.0), (0.25, 0.1)),  # within reach
    ],
)
def test_changes_are_limited_by_the_accelerations(command, last, expected):
    assert limited(KOBUKI, command, last) == pytest.approx(expected, abs=1e-6)


def test_bases_without_limits_get_the_command():
    assert limited(DifferentialDrive(), (1.0, -3.0), (0.0, 3.0)) == [1.0, -3.0]
    wheels = DifferentialDrive(model="wheeled", wheel_acceleration=1.0)
    assert limited(wheels, (1.0, 0.0), (0.0, 0.0)) == pytest.approx([0.2, 0.0])


@pytest.mark.parametrize("robot", [KOBUKI, DifferentialDrive(model="wheeled")])
def test_base_drives_the_same_with_limited_commands(robot):
    generator = torch.Generator().manual_seed(3)
    limit = CommandRateLimit(base=Base(robot))
    plain, smooth = (BatchedSimulator(4, robot, Lidar(num_beams=4)) for _ in range(2))
    for simulator in (plain, smooth):
        simulator.reset(torch.arange(4), pack(*[scene([(99.0, 0.0, 0.1, 2.0, 0.0)])] * 4))
    last = torch.zeros(4, 2)
    for _ in range(30):
        asked = torch.rand(4, 2, generator=generator) * torch.tensor([1.0, 6.0])
        asked = asked - torch.tensor([0.0, 3.0])
        last = limit.command(asked, last)
        states = plain.step(asked), smooth.step(last)
        torch.testing.assert_close(states[0].velocity, last, atol=1e-5, rtol=0)
    torch.testing.assert_close(states[0].velocity, states[1].velocity, atol=1e-5, rtol=0)


def test_limit_changes_a_command_after_the_shield():
    steps = {
        "action_shield": ActionShield(),
        "rate_limit": CommandRateLimit(base=Base(KOBUKI)),
        "subgoal": SubgoalAction(),
        "normalize": Normalize(in_keys=["points"], out_keys=["spatial"]),
    }
    names = ("normalize", "rate_limit", "action_shield", "subgoal")
    assert list(compose(**steps)) == [steps[name] for name in names]
    del steps["action_shield"]
    assert list(compose(**steps)) == [steps[name] for name in names if name in steps]


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="base='wheels': must be"):
        CommandRateLimit(base="wheels")
    with pytest.raises(ValueError, match="time_step=0"):
        CommandRateLimit(time_step=0.0)
