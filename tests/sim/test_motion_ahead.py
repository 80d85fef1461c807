"""Where the robot is when a command given now takes effect."""

import pytest
import torch
from scenes import pack, scene

from navrl.ops import se2
from navrl.sim import (
    BatchedSimulator,
    BulletSimulator,
    Delays,
    DifferentialDrive,
    Lidar,
    LimitedDrive,
    Uniform,
)

pytest.importorskip("pybullet")
SLOW = LimitedDrive(linear_acceleration=1.0, angular_acceleration=Uniform(3.0, 9.0))
SIMULATORS = (BatchedSimulator, BulletSimulator)
COMMANDS = ((0.3, 0.5), (0.2, -0.5), (0.4, 0.8))


def started(kind, delays, robot=SLOW):
    simulator = kind(3, robot, Lidar(num_beams=4), delays=delays)
    scenarios = pack(*[scene([(9.0, 0.0, 0.1, 2.0, 0.0)]) for _ in range(3)])
    scenarios.noise_seed[:] = torch.tensor([3, 4, 5])
    simulator.reset(torch.arange(3), scenarios)
    return simulator


def drive(simulator, commands=COMMANDS):
    return [simulator.step(torch.tensor([command] * 3)) for command in commands][-1]


@pytest.mark.parametrize("kind", SIMULATORS)
@pytest.mark.parametrize("robot", [SLOW, DifferentialDrive(model="wheeled")])
def test_simulator_reaches_the_predicted_pose(kind, robot):
    simulator = started(kind, Delays(command_delay_s=0.2), robot)
    before = drive(simulator)
    frames, velocity = simulator.motion_ahead()
    after = drive(simulator, [(0.0, -3.0)])  # takes effect afterwards
    reached = se2.relative(before.pose.double(), after.pose.double())
    torch.testing.assert_close(frames, reached, atol=1e-5, rtol=0)
    torch.testing.assert_close(velocity.float(), after.velocity, atol=1e-5, rtol=0)
    assert frames[:, 0].min() > 0.02


@pytest.mark.parametrize("kind", SIMULATORS)
def test_prediction_equals_that_of_a_restored_state(kind):
    simulator = started(kind, Delays(command_delay_s=0.26))
    drive(simulator)
    twin = started(kind, Delays(command_delay_s=0.26))
    twin.load_state_dict(simulator.state_dict())
    for value, other in zip(simulator.motion_ahead(), twin.motion_ahead(), strict=True):
        assert torch.equal(value, other)


def test_commands_under_way_apply_from_their_own_substep():
    simulator = started(BatchedSimulator, Delays(command_delay_s=0.3), DifferentialDrive())
    drive(simulator, [(0.2, 0.0), (0.2, 0.0), (1.0, 0.0)])
    frames, velocity = simulator.motion_ahead()
    # The last command takes effect in 0.1 s, one given now in 0.3 s.
    expected = torch.full((3,), 0.1 * 0.2 + 0.2 * 1.0, dtype=torch.float64)
    torch.testing.assert_close(frames[:, 0], expected, atol=1e-7, rtol=0)
    assert velocity[:, 0].tolist() == [1.0] * 3


def test_without_delays_it_is_the_present():
    simulator = started(BatchedSimulator, None, DifferentialDrive())
    state = drive(simulator)
    frames, velocity = simulator.motion_ahead()
    assert not frames.any()
    assert torch.equal(velocity.float(), state.velocity)


def test_delays_of_each_world_and_axis_are_used():
    delays = Delays(command_delay_s=Uniform(0.0, 0.3), turn_rate_delay_s=0.1)
    simulator = started(BatchedSimulator, delays, DifferentialDrive())
    drive(simulator, [(0.5, 0.0)] * 3)
    frames, _ = simulator.motion_ahead()
    longest = simulator.command_delays().amax(-1) * 0.02
    assert len(longest.unique()) > 1
    torch.testing.assert_close(frames[:, 0], 0.5 * longest.double(), atol=1e-7, rtol=0)
