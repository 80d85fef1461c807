"""Limits, lag and errors of a base by values calculated by hand, and draws per episode."""

import math
import re

import pytest
import torch
from episodes import sample

from navrl.sim import (
    BatchedSimulator,
    BulletSimulator,
    DifferentialDrive,
    Lidar,
    LimitedDrive,
    LogUniform,
    Uniform,
)
from navrl.worlds import ScenarioBatch

SIMULATORS = [BatchedSimulator, BulletSimulator]
STEP = 0.02  # s
ORIGIN = (0.0, 0.0, 0.0)
REST = (0.0, 0.0)
VARIED = LimitedDrive(
    linear_acceleration=LogUniform(0.3, 3.0),
    angular_acceleration=LogUniform(2.5, 20.0),
    wheel_acceleration=LogUniform(0.8, 8.0),
    angular_lag_s=Uniform(0.0, 0.2),
    linear_scale=Uniform(0.9, 1.1),
    angular_bias=Uniform(-0.05, 0.05),
    speed_cap=Uniform(0.4, 1.0),
)


def velocities(robot, command, duration, velocity=REST):
    """Return (v, w) after each substep of ``duration`` s with a constant command."""
    pose, found = ORIGIN, []
    for _ in range(round(duration / STEP)):
        pose, velocity = robot.advance_one(pose, velocity, command, STEP)
        found.append(velocity)
    return found


# --- effects ------------------------------------------------------------------------------------


def test_speed_rises_and_falls_at_its_limits():
    """0.7 m/s at 0.5 m/s^2 takes 1.4 s; down at 0.6 m/s^2 it takes 1.17 s."""
    robot = LimitedDrive(linear_acceleration=0.5, linear_deceleration=0.6)
    up = [v for v, _ in velocities(robot, (0.7, 0.0), 1.6)]
    assert up[0] == pytest.approx(0.01) and up[49] == pytest.approx(0.5)
    assert up[68] == pytest.approx(0.69) and up[69:] == pytest.approx([0.7] * 11)
    down = [v for v, _ in velocities(robot, REST, 1.2, (0.7, 0.0))]
    assert down[49] == pytest.approx(0.1)
    assert down[57] == pytest.approx(0.7 - 58 * 0.012) and down[58:] == [0.0, 0.0]


def test_turn_rate_rises_and_falls_at_its_limits():
    """From -1.05 rad/s to rest at 4.2 rad/s^2 in 0.25 s, then at 3.5 rad/s^2."""
    robot = LimitedDrive(angular_acceleration=3.5, angular_deceleration=4.2)
    w = [w for _, w in velocities(robot, (0.5, 2.0), 0.5, (0.5, -1.05))]
    assert w[11] == pytest.approx(-1.05 + 0.24 * 4.2)
    assert w[12] == pytest.approx(0.042)  # the sign changes within the substep
    assert w[13] == pytest.approx(0.042 + 0.07)
    assert velocities(robot, (0.5, 2.0), 0.02)[0][0] == 0.5  # v is not limited


def test_deceleration_defaults_to_the_drawn_acceleration():
    robot = LimitedDrive(linear_acceleration=LogUniform(0.3, 3.0))
    row = robot.draw(torch.arange(100))
    assert len(set(row[:, 8].tolist())) == 100 and row[:, 8].equal(row[:, 10])


@pytest.mark.parametrize("axis", [0, 1])
def test_lag_reaches_63_percent_after_its_time_constant(axis):
    robot = LimitedDrive(**{("linear_lag_s", "angular_lag_s")[axis]: 0.1})
    found = [velocity[axis] for velocity in velocities(robot, (0.8, 0.8), 0.3)]
    assert found[4] == pytest.approx(0.8 * (1.0 - math.exp(-1.0)), rel=1e-9)
    assert found[14] == pytest.approx(0.8 * (1.0 - math.exp(-3.0)), rel=1e-9)
    assert velocities(robot, (0.8, 0.8), 0.02)[0][1 - axis] == 0.8


def test_command_is_clipped_scaled_biased_then_capped():
    robot = LimitedDrive(linear_scale=1.1, angular_scale=0.9, linear_bias=0.02, angular_bias=-0.05)
    assert velocities(robot, (5.0, 2.0), STEP)[0] == pytest.approx((1.12, 1.75))
    capped = LimitedDrive(linear_scale=1.1, speed_cap=0.6, turn_rate_cap=1.5)
    assert velocities(capped, (0.5, -3.0), STEP)[0] == pytest.approx((0.55, -1.5))
    assert velocities(capped, (0.9, 0.0), STEP)[0] == (0.6, 0.0)


def test_biased_base_does_not_creep_at_a_zero_command():
    robot = LimitedDrive(linear_bias=0.02, angular_bias=0.05)
    assert velocities(robot, REST, 0.2)[-1] == (0.0, 0.0)
    assert velocities(robot, (0.5, 0.0), STEP)[0] == pytest.approx((0.52, 0.05))
    assert velocities(robot, (0.0, 1.0), STEP)[0] == pytest.approx((0.02, 1.05))


def test_wheel_limit_equals_that_of_the_wheeled_drive():
    limited = LimitedDrive(wheel_acceleration=1.0)
    wheeled = DifferentialDrive(model="wheeled", wheel_acceleration=1.0)
    for command in [(0.5, 2.0), (1.0, -3.0), (0.0, 0.0)]:
        pair = [velocities(robot, command, 0.4, (0.3, -0.5)) for robot in (limited, wheeled)]
        for a, b in zip(*pair, strict=True):
            assert a == pytest.approx(b, abs=1e-12)


def test_all_limits_hold_together():
    robot = LimitedDrive(
        linear_acceleration=0.5, angular_acceleration=6.0, wheel_acceleration=0.6, linear_lag_s=0.1
    )
    generator = torch.Generator().manual_seed(0)
    command = torch.rand(50, 64, 2, generator=generator, dtype=torch.float64) * 6 - 3
    pose, velocity = torch.zeros(64, 3).double(), torch.zeros(64, 2).double()
    _, after = robot.rollout(pose, velocity, command, STEP)
    change = torch.cat((velocity[None], after)).diff(dim=0).abs()
    assert change[..., 0].max() <= 0.5 * STEP + 1e-12
    assert change[..., 1].max() <= 6.0 * STEP + 1e-12
    rims = robot.wheel_speeds(torch.cat((velocity[None], after))).diff(dim=0).abs()
    assert 0.59 * STEP < rims.max() <= 0.6 * STEP + 1e-12


def test_rollout_equals_single_substeps():
    generator = torch.Generator().manual_seed(0)
    row = VARIED.draw(torch.arange(32))
    commands = torch.rand(100, 32, 2, generator=generator, dtype=torch.float64) * 4
    pose, velocity = torch.zeros(32, 3).double(), torch.zeros(32, 2).double()
    poses, rolled = VARIED.rollout(pose, velocity, commands, STEP, row)
    for index, command in enumerate(commands):
        pose, velocity = VARIED.advance(pose, velocity, command, STEP, row)
        torch.testing.assert_close(poses[index], pose, rtol=0, atol=1e-12)
        torch.testing.assert_close(rolled[index], velocity, rtol=0, atol=1e-12)
    assert bool((poses[:, :, 2].diff(dim=0) < -6.0).any())  # some yaw wraps


def test_base_without_parameters_is_the_nominal_one():
    nominal = LimitedDrive(linear_acceleration=0.9, speed_cap=0.7)
    varied = LimitedDrive(linear_acceleration=Uniform(0.3, 1.5), speed_cap=Uniform(0.4, 1.0))
    found = [velocities(robot, (1.0, 0.3), 1.0) for robot in (varied, nominal)]
    assert found[0] == [pytest.approx(velocity, rel=1e-9) for velocity in found[1]]
    assert varied.acceleration_limit == pytest.approx(0.9)


@pytest.mark.parametrize(
    "name, value, allowed",
    [
        ("linear_acceleration", 0.0, "positive"),
        ("angular_deceleration", Uniform(-1.0, 1.0), "positive"),
        ("wheel_acceleration", math.nan, "positive"),
        ("speed_cap", 0.0, "positive"),
        ("linear_lag_s", -0.1, "finite and >= 0 s"),
        ("angular_lag_s", math.inf, "finite and >= 0 s"),
        ("linear_scale", 0.0, "positive and finite"),
        ("angular_bias", math.inf, "finite"),
        ("radius", 0.0, "positive and finite"),
    ],
)
def test_invalid_value_is_rejected(name, value, allowed):
    message = re.escape(f"{name}={value}: must be {allowed}")
    with pytest.raises(ValueError, match=f"^{message}$"):
        LimitedDrive(**{name: value})


# --- in simulators ------------------------------------------------------------------------------


def make(simulator, robot, indices=(1, 2, 3)):
    sim = simulator(len(indices), robot, Lidar(num_beams=8, noise="none"))
    sim.reset(torch.arange(len(indices)), batch(*indices))
    return sim


def batch(*indices):
    return ScenarioBatch.pack([sample("clutter", index) for index in indices])


def commands(steps, num_worlds=3):
    generator = torch.Generator().manual_seed(0)
    draws = torch.rand(steps, num_worlds, 2, generator=generator)
    return draws * torch.tensor([1.2, 6.0]) - torch.tensor([0.2, 3.0])


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_defaults_are_bit_equal_to_the_kinematic_drive(simulator):
    sims = [make(simulator, robot) for robot in (LimitedDrive(), DifferentialDrive())]
    assert sims[0].robot.draw(torch.arange(3)).shape == (3, 0)
    for command in commands(30):
        a, b = (sim.step(command) for sim in sims)
        assert a.pose.equal(b.pose) and a.velocity.equal(b.velocity)
    pose = [sim.state_dict()["pose"] for sim in sims]
    assert pose[0].equal(pose[1]) and sims[0].state_dict().keys() == sims[1].state_dict().keys()


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_partial_reset_draws_the_reset_worlds_only(simulator):
    sim = make(simulator, VARIED)
    before = sim.robot_parameters.clone()
    assert before.equal(VARIED.draw(batch(1, 2, 3).noise_seed))
    sim.reset(torch.tensor([2, 0]), batch(8, 9))
    drawn = VARIED.draw(batch(8, 9).noise_seed)
    assert sim.robot_parameters.equal(torch.stack((drawn[1], before[1], drawn[0])))


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_drawn_base_is_restored_with_the_state(simulator):
    sim, other = make(simulator, VARIED), make(simulator, VARIED, (7, 8, 9))
    given = commands(10)
    for command in given[:5]:
        sim.step(command)
    other.load_state_dict(sim.state_dict())
    for command in given[5:]:
        a, b = sim.step(command), other.step(command)
        assert a.pose.equal(b.pose) and a.velocity.equal(b.velocity)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_state_without_parameters_fits_fixed_bases_only(simulator):
    plain = make(simulator, DifferentialDrive())
    state = plain.state_dict()
    assert "robot_parameters" not in state
    make(simulator, LimitedDrive(linear_acceleration=0.5)).load_state_dict(state)
    with pytest.raises(ValueError, match="robot_parameters"):
        make(simulator, VARIED).load_state_dict(state)
    with pytest.raises(ValueError, match="robot_parameters"):
        plain.load_state_dict(make(simulator, VARIED).state_dict())


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_episode_does_not_depend_on_its_world(simulator):
    order = torch.tensor([2, 0, 1])
    sims = make(simulator, VARIED), make(simulator, VARIED, (3, 1, 2))
    for command in commands(20):
        a, b = sims[0].step(command), sims[1].step(command[order])
        torch.testing.assert_close(a.pose[order], b.pose, rtol=0, atol=1e-6)
        assert a.contact[order].equal(b.contact)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_each_world_moves_with_its_drawn_base(simulator):
    robot = LimitedDrive(speed_cap=Uniform(0.2, 0.6))
    state = make(simulator, robot).step(torch.tensor([[1.0, 0.0]]).expand(3, 2))
    drawn = robot.draw(batch(1, 2, 3).noise_seed)[:, 4]
    assert state.velocity[:, 0].tolist() == pytest.approx(drawn.tolist(), abs=1e-6)


def test_subclass_with_own_motion_is_not_compiled():
    class Reluctant(DifferentialDrive):
        def advance(self, pose, velocity, command, duration, parameters=None):
            return super().advance(pose, velocity, 0.5 * command, duration)

    sims = [make(BatchedSimulator, Reluctant()), make(BatchedSimulator, DifferentialDrive())]
    command = torch.tensor([[0.8, 0.4]]).expand(3, 2)
    states = sims[0].step(command), sims[1].step(0.5 * command)
    torch.testing.assert_close(states[0].pose, states[1].pose)
