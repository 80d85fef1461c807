"""Other bases, reactive pedestrians and delays through the interfaces of both simulators."""

import math

import pytest
import torch
from episodes import sample
from models import Fleeing, Omnidirectional
from scenes import pack, scene, stander, walker

from navrl.sim import BatchedSimulator, BulletSimulator, Contact, Delays, DifferentialDrive, Lidar
from navrl.sim.delays import CommandQueue
from navrl.worlds import ScenarioBatch

SIMULATORS = [BatchedSimulator, BulletSimulator]
WALL = (3.0, 0.0, 0.1, 2.0, 0.0)


def make(simulator, scenario, robot=None, **options):
    sim = simulator(1, robot or DifferentialDrive(), Lidar(num_beams=8, noise="none"), **options)
    sim.reset(torch.tensor([0]), pack(scenario))
    return sim


def drive(sim, *commands):
    return [sim.step(torch.tensor([command])) for command in commands]


# --- another base -----------------------------------------------------------------------------


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_omnidirectional_base_moves_sideways(simulator):
    sim = make(simulator, scene(), Omnidirectional())
    (state,) = drive(sim, (0.0, 0.5, 0.0))
    assert state.pose[0].tolist() == pytest.approx([0.0, 0.1, 0.0], abs=1e-6)
    assert state.velocity.tolist() == [[0.0, 0.5, 0.0]]


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_contact_is_classified_by_direction_of_travel(simulator):
    """Sideways into a pedestrian on the left: the robot is at fault, though it faces ahead."""
    sim = make(simulator, scene(pedestrians=[stander(0.0, 0.5)]), Omnidirectional())
    states = drive(sim, *[(0.0, 0.5, 0.0)] * 3)
    assert states[-1].contact.tolist() == [Contact.PEDESTRIAN]
    assert states[-1].pose[0, 1].item() == pytest.approx(0.15, abs=0.011)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_velocity_is_that_of_the_substep_of_contact(simulator):
    class Slowing(Omnidirectional):
        def advance(self, pose, velocity, command, duration):
            slower = torch.where(velocity > 0.1, velocity - 0.1, command)
            return super().advance(pose, velocity, slower, duration)

    sim = make(simulator, scene(boxes=[(0.265, 0.0, 0.05, 1.0, 0.0)]), Slowing())
    (state,) = drive(sim, (1.0, 0.0, 0.0))
    assert state.time_s.item() == pytest.approx(0.02)
    assert state.velocity[0].tolist() == pytest.approx([1.0, 0.0, 0.0])


def test_command_of_a_wrong_size_is_rejected():
    sim = make(BatchedSimulator, scene(), Omnidirectional())
    with pytest.raises(ValueError, match=r"command: must be \[1, 3\], got \[1, 2\]"):
        sim.step(torch.zeros(1, 2))


def test_a_drive_through_the_interface_equals_the_compiled_one():
    class Plain(DifferentialDrive):
        pass

    class Wrapped(Omnidirectional):  # not a DifferentialDrive, so driven by its torch code
        def __init__(self, drive):
            self.drive, self.radius, self.command_limits = drive, drive.radius, drive.command_limits

        def advance(self, *arguments):
            return self.drive.advance(*arguments)

        travel = DifferentialDrive.travel

    scenes = [sample(kind, 3) for kind in ("corridor", "office", "clutter")]
    robot = Plain(model="wheeled", wheel_acceleration=1.5)
    sims = [BatchedSimulator(3, base, Lidar(num_beams=8)) for base in (robot, Wrapped(robot))]
    for sim in sims:
        sim.reset(torch.arange(3), ScenarioBatch.pack(scenes))
    generator = torch.Generator().manual_seed(0)
    for _ in range(40):
        command = torch.rand(3, 2, generator=generator) * 2 - torch.tensor([0.5, 1.0])
        a, b = (sim.step(command) for sim in sims)
        assert torch.allclose(a.pose, b.pose, atol=1e-6) and a.contact.equal(b.contact)
        assert torch.allclose(a.velocity, b.velocity, atol=1e-6) and a.time_s.equal(b.time_s)


# --- reactive pedestrians -----------------------------------------------------------------------


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_reactive_pedestrian_walks_to_its_targets(simulator):
    sim = make(simulator, scene(pedestrians=[stander(1.0, 0.0)]), pedestrians=Fleeing(speed=0.5))
    first, second = drive(sim, (0.0, 0.0), (0.0, 0.0))
    assert first.pedestrians[0, 0].tolist() == pytest.approx([1.1, 0.0, 0.15, 0.15, 0.0])
    assert second.pedestrians[0, 0].tolist() == pytest.approx([1.2, 0.0, 0.15, 0.15, 0.0])
    assert sim.ranges()[0, 0].item() == pytest.approx(1.05, abs=1e-5)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_reset_returns_reactive_pedestrians_to_their_start(simulator):
    episode = scene(pedestrians=[walker((1.0, 0.0), (4.0, 0.0), speed=0.3)])
    sim = make(simulator, episode, pedestrians=Fleeing())
    drive(sim, *[(0.0, 0.0)] * 3)
    sim.reset(torch.tensor([0]), pack(episode))
    assert sim.state().pedestrians[0, 0, :2].tolist() == [1.0, 0.0]


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_contact_with_a_fast_reactive_pedestrian_is_detected(simulator):
    """It moves 0.7 m in a step, from 0.61 m off the hull into it."""

    class Runner(Fleeing):
        def targets(self, state, duration_s):
            return state.pedestrians[..., :2] + torch.tensor([0.0, 0.7])

    people = [stander(0.0, 1.5)]
    sim = make(simulator, scene(start=(0.0, 2.5, 0.0), pedestrians=people), pedestrians=Runner())
    (state,) = drive(sim, (0.0, 0.0))
    assert state.contact.tolist() == [Contact.HIT_BY_PEDESTRIAN]


@pytest.mark.parametrize("bad", [torch.zeros(1, 10, 3), torch.full((1, 10, 2), math.inf)])
def test_bad_targets_are_rejected(bad):
    model = Fleeing()
    model.targets = lambda *_: bad
    sim = make(BatchedSimulator, scene(pedestrians=[stander(1.0, 0.0)]), pedestrians=model)
    with pytest.raises(ValueError, match=r"targets: must be \[1, 10, 2\]"):
        drive(sim, (0.0, 0.0))


def test_nan_targets_keep_pedestrians_on_their_routes():
    class Scripted(Fleeing):
        def targets(self, state, duration_s):
            return torch.full_like(state.pedestrians[..., :2], torch.nan)

    sims = [
        BatchedSimulator(2, DifferentialDrive(), Lidar(num_beams=8), pedestrians=model)
        for model in (None, Scripted())
    ]
    for sim in sims:
        sim.reset(torch.arange(2), ScenarioBatch.pack([sample("office", i) for i in (1, 2)]))
    for _ in range(20):
        a, b = (sim.step(torch.tensor([[0.3, 0.2]] * 2)) for sim in sims)
        assert a.pedestrians.nan_to_num().equal(b.pedestrians.nan_to_num())


# --- delays -----------------------------------------------------------------------------------


@pytest.mark.parametrize("simulator", SIMULATORS)
@pytest.mark.parametrize("delay, travelled", [(0.0, 0.2), (0.1, 0.1), (0.2, 0.0), (0.3, 0.0)])
def test_first_command_takes_effect_after_its_delay(simulator, delay, travelled):
    sim = make(simulator, scene(), delays=Delays(speed_delay_s=delay, turn_rate_delay_s=delay))
    first, second = drive(sim, (1.0, 0.0), (0.0, 0.0))
    assert first.pose[0, 0].item() == pytest.approx(travelled, abs=1e-6)
    assert second.pose[0, 0].item() == pytest.approx(0.2 if delay < 0.3 else 0.1, abs=1e-6)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_axes_are_delayed_separately(simulator):
    sim = make(simulator, scene(), delays=Delays(turn_rate_delay_s=0.2))
    first, second = drive(sim, (0.5, 1.0), (0.5, 1.0))
    assert first.pose[0].tolist() == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)
    assert second.pose[0, 2].item() == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize("simulator", SIMULATORS)
@pytest.mark.parametrize("age", [0.0, 0.06, 0.2, 0.26, 0.4])
def test_scan_shows_the_past_of_robot_and_pedestrians(simulator, age):
    """Wall 2.9 m ahead, robot at 1 m/s; a pedestrian behind comes nearer at 0.5 m/s."""
    behind = walker((-3.0, 0.0), (3.0, 0.0), speed=0.5)
    sim = make(simulator, scene([WALL], pedestrians=[behind]), delays=Delays(scan_age_s=age))
    for step in range(1, 4):
        drive(sim, (1.0, 0.0))
        then = max(0.2 * step - age, 0.0)
        ranges = sim.ranges()[0]
        assert ranges[0].item() == pytest.approx(2.9 - then, abs=1e-4)
        assert ranges[4].item() == pytest.approx(2.85 + 0.5 * then, abs=1e-4)
    assert sim.state().pose[0, 0].item() == pytest.approx(0.6, abs=1e-6)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_reset_clears_commands_and_scans(simulator):
    delays = Delays(scan_age_s=0.4, speed_delay_s=0.4, turn_rate_delay_s=0.4)
    sim = make(simulator, scene([WALL]), delays=delays)
    drive(sim, *[(1.0, 1.0)] * 4)
    sim.reset(torch.tensor([0]), pack(scene([WALL])))
    assert sim.ranges()[0, 0].item() == pytest.approx(2.9, abs=1e-4)
    (state,) = drive(sim, (1.0, 1.0))
    assert state.pose[0].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_state_of_delays_is_restored(simulator):
    delays = Delays(scan_age_s=0.26, speed_delay_s=0.3, turn_rate_delay_s=0.1)
    make_one = lambda: make(simulator, scene([WALL]), delays=delays)  # noqa: E731
    sim, other = make_one(), make_one()
    drive(sim, (1.0, 0.5), (0.6, -0.5), (0.8, 0.1))
    other.load_state_dict(sim.state_dict())
    for _ in range(3):
        a, b = (drive(each, (0.4, 0.3))[0] for each in (sim, other))
        assert torch.equal(a.pose, b.pose) and torch.equal(sim.ranges(), other.ranges())


@pytest.mark.parametrize(
    "key, value", [("scan_age_s", -0.1), ("speed_delay_s", math.inf), ("scan_age_s", math.nan)]
)
def test_invalid_delay_is_rejected(key, value):
    with pytest.raises(ValueError, match=f"{key}={value}: must be finite and >= 0 s"):
        Delays(**{key: value})


def test_delay_between_substeps_is_rejected():
    with pytest.raises(ValueError, match=r"scan_age_s=0.05: must be a multiple of the substep"):
        make(BatchedSimulator, scene(), delays=Delays(scan_age_s=0.05))


def test_ideal_queue_passes_commands_through():
    queue = CommandQueue(2, 2, Delays(), 10, 0.02, torch.device("cpu"))
    command = torch.rand(2, 2)
    assert queue.push(command).equal(command[:, None]) and queue.num_steps == 0


# --- facts of a base ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "robot, speed, bearings",
    [
        (DifferentialDrive(), 1.0, (0.0,)),
        (DifferentialDrive(min_speed=-0.2), 1.0, (0.0, math.pi)),
        (Omnidirectional(), math.hypot(1.0, 0.5), (-math.pi / 2, 0.0, math.pi / 2, math.pi)),
    ],
)
def test_base_reports_top_speed_and_bearings_of_travel(robot, speed, bearings):
    assert robot.top_speed == pytest.approx(speed, abs=1e-12)
    assert robot.travel_bearings == bearings
