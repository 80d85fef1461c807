"""Delays drawn per episode, jitter and spinning lidars, by hand and on both simulators."""

import math
from dataclasses import replace

import pytest
import torch
from episodes import sample
from models import Omnidirectional
from scenes import pack, scene, walker

from navrl.config import compose, instantiate, options
from navrl.ops.beams import first_beam
from navrl.sim import BatchedSimulator, BulletSimulator, Delays, DifferentialDrive, Lidar, Uniform
from navrl.sim.draws import draw
from navrl.worlds import ScenarioBatch

pytest.importorskip("pybullet")
SIMULATORS = [BatchedSimulator, BulletSimulator]
WALL_AHEAD = (3.0, 0.0, 0.1, 2.0, 0.0)
WALLS_AROUND = [
    (0.0, 2.0, 9.0, 0.1, 0.0),
    (0.0, -2.0, 9.0, 0.1, 0.0),
    (3.0, 0.0, 0.1, 2.0, 0.0),
    (-3.0, 0.0, 0.1, 2.0, 0.0),
]
SUBSTEP = 0.02  # s
VARIED = Delays(
    scan_age_s=Uniform(0.0, 0.3),
    command_delay_s=Uniform(0.0, 0.3),
    revolution_s=Uniform(0.0, 0.2),
    scan_jitter_s=0.1,
    command_jitter_s=0.1,
)


def make(simulator, *scenes, robot=None, num_beams=8, **options):
    lidar = options.pop("lidar", Lidar(num_beams=num_beams, noise="none"))
    sim = simulator(len(scenes), robot or DifferentialDrive(), lidar, **options)
    sim.reset(torch.arange(len(scenes)), pack(*scenes))
    return sim


def drive(sim, *commands):
    return [sim.step(torch.tensor([command] * sim.num_worlds)) for command in commands]


def commands(num_worlds, steps, seed=0):
    generator = torch.Generator().manual_seed(seed)
    command = torch.rand(steps, num_worlds, 2, generator=generator)
    return command * torch.tensor([1.0, 3.0]) - torch.tensor([0.0, 1.5])


# --- ages and delays of episodes --------------------------------------------------------------


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_range_is_too_long_by_speed_times_age(simulator):
    sim = make(simulator, scene([WALL_AHEAD]), delays=Delays(scan_age_s=0.1))
    drive(sim, (1.0, 0.0), (1.0, 0.0))
    assert sim.ranges()[0, 0].item() == pytest.approx(2.9 - 0.4 + 0.1, abs=1e-4)
    motion = sim.scan_motion()
    assert motion.dtype == torch.float64
    assert motion.flatten().tolist() == pytest.approx([-0.1, 0.0, 0.0] * 2, abs=1e-9)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_each_episode_has_its_drawn_delays(simulator):
    """Robots at 1 m/s: ages show in the ranges, delays in the paths."""
    seeds = torch.arange(5)
    delays = Delays(scan_age_s=Uniform(0.0, 0.3), command_delay_s=Uniform(0.0, 0.2))
    sim = make(
        simulator, *(scene([WALL_AHEAD], noise_seed=seed) for seed in range(5)), delays=delays
    )
    age, delay = (
        (draw(name, getattr(delays, name), seeds) / SUBSTEP).round() * SUBSTEP
        for name in ("scan_age_s", "command_delay_s")
    )
    assert len(set(age.tolist())) > 2 and len(set(delay.tolist())) > 2
    drive(sim, *[(1.0, 0.0)] * 3)
    driven = 0.6 - delay
    torch.testing.assert_close(sim.state().pose[:, 0].double(), driven, atol=1e-6, rtol=0)
    seen = 2.9 - (driven - age)
    torch.testing.assert_close(sim.ranges()[:, 0].double(), seen, atol=1e-4, rtol=0)
    assert torch.equal(sim.command_delays(), (delay / SUBSTEP).round().long()[:, None].expand(5, 2))


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_command_delay_adds_to_that_of_an_axis(simulator):
    sim = make(simulator, scene(), delays=Delays(command_delay_s=0.06, turn_rate_delay_s=0.1))
    (state,) = drive(sim, (0.5, 1.0))
    assert state.velocity[0].tolist() == pytest.approx([0.5, 1.0])
    assert state.pose[0, 2].item() == pytest.approx(0.2 - 0.16, abs=1e-6)
    assert sim.command_delays().tolist() == [[3, 8]]


def test_pending_commands_state_when_they_take_effect():
    sim = make(BatchedSimulator, scene(), delays=Delays(command_delay_s=0.3, speed_delay_s=0.02))
    drive(sim, (0.1, 0.0), (0.2, 0.5), (0.3, 0.6))
    pending, remaining = sim.pending_commands()
    assert pending.flatten().tolist() == pytest.approx([0.3, 0.6, 0.2, 0.5])
    assert remaining.tolist() == [[[6, 5], [-4, -5]]]
    assert sim.state().velocity[0].tolist() == pytest.approx([0.2, 0.5])
    (state,) = drive(sim, (0.0, 0.0))
    assert state.velocity[0].tolist() == pytest.approx([0.3, 0.6])


def test_no_commands_are_pending_without_delay():
    sim = make(BatchedSimulator, scene())
    pending, remaining = sim.pending_commands()
    assert pending.shape == (1, 0, 2) and remaining.shape == (1, 0, 2)


# --- jitter -----------------------------------------------------------------------------------


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_command_never_gives_way_to_an_earlier_one(simulator):
    """Each command is faster than the last, so speed may only rise, whatever the jitter."""
    sim = make(
        simulator,
        *(scene(noise_seed=seed) for seed in range(6)),
        robot=DifferentialDrive(max_speed=10.0),
        delays=Delays(command_jitter_s=0.5),
        time_step_s=0.1,
        substeps=5,
    )
    speeds = torch.stack(
        [state.velocity[:, 0] for state in drive(sim, *[(0.1 * step, 0.0) for step in range(25)])]
    )
    rise = speeds.diff(dim=0)
    assert bool((rise >= -1e-6).all()) and len({round(x, 3) for x in rise.flatten().tolist()}) > 3


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_jitter_differs_between_steps_within_its_range(simulator):
    delays = Delays(scan_age_s=0.04, scan_jitter_s=0.1)
    sim = make(simulator, scene(noise_seed=3), robot=Omnidirectional(), delays=delays)
    ages = []
    for _ in range(20):
        drive(sim, (1.0, 0.0, 0.0))
        ages.append(round(-sim.scan_motion()[0, 1, 0].item(), 6))
    assert min(ages) >= 0.04 and max(ages) <= 0.14 and len(set(ages)) > 3


def test_scan_is_never_older_than_the_scan_before_it():
    sim = make(
        BatchedSimulator,
        *(scene(noise_seed=seed) for seed in range(8)),
        delays=Delays(scan_jitter_s=0.5),
        time_step_s=0.1,
        substeps=5,
    )
    seen = []
    for _ in range(30):
        state = drive(sim, (1.0, 0.0))[0]
        seen.append(state.pose[:, 0] + sim.scan_motion()[:, 1, 0])
    assert bool((torch.stack(seen).diff(dim=0) >= -1e-5).all())


# --- spinning lidars --------------------------------------------------------------------------


@pytest.mark.parametrize("simulator", SIMULATORS)
@pytest.mark.parametrize("age", [0.0, 0.1])
def test_seam_of_a_spinning_scan_is_speed_times_revolution(simulator, age):
    """Beam 0 and the last beam both look ahead, at a wall that the robot approaches at 1 m/s."""
    lidar = Lidar(num_beams=3601, noise="none", angle_min=0.0)
    sim = make(
        simulator,
        scene([WALL_AHEAD]),
        lidar=lidar,
        delays=Delays(revolution_s=0.2, scan_age_s=age),
    )
    drive(sim, *[(1.0, 0.0)] * 3)
    ranges = sim.ranges()[0]
    assert (ranges[0] - ranges[-1]).item() == pytest.approx(0.2, abs=1e-4)
    assert ranges[-1].item() == pytest.approx(2.9 - (0.6 - age), abs=1e-4)
    motion = sim.scan_motion().flatten().tolist()
    assert motion == pytest.approx([-0.2 - age, 0.0, 0.0, -age, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_each_beam_is_measured_at_its_own_time(simulator):
    """Beside walls, turning and driving: each beam is that of a still scan of its substep."""
    spinning = make(
        simulator,
        scene(WALLS_AROUND, pedestrians=[walker((1.5, 1.0), (1.5, -1.0), speed=1.0)]),
        num_beams=101,
        delays=Delays(revolution_s=0.1, scan_age_s=0.04),
    )
    still = [
        make(
            simulator,
            scene(WALLS_AROUND, pedestrians=[walker((1.5, 1.0), (1.5, -1.0), speed=1.0)]),
            num_beams=101,
            delays=Delays(scan_age_s=age * SUBSTEP),
        )
        for age in range(2, 8)
    ]
    for sim in (spinning, *still):
        drive(sim, (0.6, 1.5), (0.4, -0.5), (0.6, 2.0))
    age = torch.tensor([7 - math.floor(0.5 + 5 * beam / 100) for beam in range(101)])
    wanted = torch.stack([sim.ranges()[0] for sim in still])[age - 2, torch.arange(101)]
    assert torch.equal(spinning.ranges()[0], wanted)
    first, last = (sim.scan_motion()[0, 0] for sim in (still[5], still[0]))
    assert torch.equal(spinning.scan_motion()[0], torch.stack((first, last)))


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_beams_of_half_a_circle_take_half_a_revolution(simulator):
    lidar = Lidar(num_beams=180, noise="none", angle_min=-1.57, angle_increment=math.pi / 180)
    sim = make(simulator, scene(), lidar=lidar, delays=Delays(revolution_s=0.2))
    drive(sim, (1.0, 0.0), (1.0, 0.0))
    assert sim.scan_motion()[0, :, 0].tolist() == pytest.approx([-0.1, 0.0], abs=1e-9)


def test_parts_of_a_sweep_share_all_beams():
    for num_beams in (1, 2, 7, 360):
        for num_parts in (1, 2, 6, 11):
            first = [first_beam(part, num_parts, num_beams) for part in range(num_parts + 1)]
            assert first[0] == 0 and first[-1] == num_beams and first == sorted(first)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_scan_motion_is_the_frame_of_the_past_in_the_present(simulator):
    """A quarter of a left turn: the past lies behind to the left, turned to the right."""
    robot = DifferentialDrive(max_turn_rate=10.0)
    rate = math.pi / 2 / 0.2  # rad/s
    sim = make(simulator, scene(start=(5.0, -3.0, 2.0)), robot=robot, delays=Delays(scan_age_s=0.2))
    drive(sim, (1.0, rate))
    radius = 1.0 / rate
    assert sim.scan_motion()[0, 1].tolist() == pytest.approx(
        [-radius, radius, -math.pi / 2], abs=1e-6
    )


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_scan_motion_is_zero_without_age(simulator):
    for delays in (None, Delays(command_delay_s=0.1), Delays(scan_age_s=Uniform(0.0, 0.0))):
        sim = make(simulator, scene(), delays=delays)
        drive(sim, (0.7, 0.3))
        assert sim.scan_motion().tolist() == [[[0.0] * 3] * 2]


# --- resets, states and batches ---------------------------------------------------------------


def scenarios(count, first=0):
    kinds = ("corridor", "intersection", "office", "clutter")
    chosen = [sample(kinds[i % 4], i) for i in range(first, first + count)]
    return [replace(each, noise_seed=50 + i) for i, each in enumerate(chosen, first)]


def started(simulator, chosen, **options):
    sim = simulator(len(chosen), DifferentialDrive(), Lidar(num_beams=90, noise="none"), **options)
    sim.reset(torch.arange(len(chosen)), ScenarioBatch.pack(chosen))
    return sim


def observed(sim):
    state = sim.state()
    return [state.pose, state.velocity, state.contact, sim.ranges(), sim.scan_motion()]


def assert_equal(first, second):
    for a, b in zip(first, second, strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_order_of_worlds_does_not_change_episodes(simulator):
    chosen = scenarios(6)
    order = torch.tensor([4, 1, 5, 0, 3, 2])
    sims = [
        started(simulator, each, delays=VARIED) for each in (chosen, [chosen[i] for i in order])
    ]
    for command in commands(6, steps=10):
        sims[0].step(command), sims[1].step(command[order])
        assert_equal([value[order] for value in observed(sims[0])], observed(sims[1]))


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_partial_reset_starts_the_same_episode(simulator):
    """A world that is reset late plays what it plays in a new simulator; others do not change."""
    chosen, given = scenarios(3), commands(3, steps=12)
    late, alone = (started(simulator, chosen, delays=VARIED) for _ in range(2))
    for command in given[:5]:
        late.step(command)
    before = observed(late)
    late.reset(torch.tensor([1]), ScenarioBatch.pack([chosen[1]]))
    others = torch.tensor([0, 2])
    assert_equal([value[others] for value in before], [value[others] for value in observed(late)])
    assert_equal([value[1] for value in observed(late)], [value[1] for value in observed(alone)])
    for command in given[5:]:
        late.step(command), alone.step(command)
        assert_equal([v[1] for v in observed(late)], [v[1] for v in observed(alone)])


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_restored_state_continues_bit_for_bit(simulator):
    chosen, given = scenarios(4), commands(4, steps=12)
    sim, other = (started(simulator, each, delays=VARIED) for each in (chosen, scenarios(4, 8)))
    for command in given[:5]:
        sim.step(command)
    saved = sim.state_dict()
    other.load_state_dict(saved)
    for command in given[5:]:
        assert_equal(observed(sim), observed(other))
        sim.step(command), other.step(command)
    assert_equal(observed(sim), observed(other))


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_state_of_other_delays_is_rejected(simulator):
    sim, other = (
        started(simulator, scenarios(1), delays=Delays(scan_age_s=age)) for age in (0.1, 0.2)
    )
    with pytest.raises(ValueError, match=r"state\['scans.pose'\]: must have shape \[1, 11, 3\]"):
        other.load_state_dict(sim.state_dict())


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_frozen_world_retains_its_scan(simulator):
    wall = (0.5, 0.0, 0.1, 2.0, 0.0)
    sim = make(simulator, scene([wall], noise_seed=2), delays=VARIED)
    drive(sim, *[(1.0, 0.5)] * 5)
    assert sim.state().contact.item() == 1
    before = observed(sim)
    drive(sim, *[(1.0, 0.5)] * 3)
    assert_equal(before, observed(sim))


# --- configuration ----------------------------------------------------------------------------


def test_every_timing_option_has_substeps_of_20_ms():
    for name in options("timing"):
        timing = compose("evaluate", [f"timing={name}"]).timing
        assert timing.time_step_s / timing.substeps == pytest.approx(SUBSTEP)
        sim = BatchedSimulator(
            1,
            DifferentialDrive(),
            Lidar(),
            timing.time_step_s,
            timing.substeps,
            delays=instantiate(timing.delays),
        )
        is_instant = name.startswith(("ideal", "command", "period", "turn"))
        assert sim.scan_memory.is_used != is_instant


def test_value_of_each_episode_may_be_any_number():
    make(BatchedSimulator, scene(), delays=Delays(scan_age_s=Uniform(0.01, 0.017)))
    with pytest.raises(
        ValueError, match=r"command_delay_s=0\.05: must be a multiple of the substep"
    ):
        make(BatchedSimulator, scene(), delays=Delays(command_delay_s=0.05))
    with pytest.raises(ValueError, match=r"scan_age_s=Uniform.*: must be finite and >= 0 s"):
        Delays(scan_age_s=Uniform(-0.1, 0.1))
