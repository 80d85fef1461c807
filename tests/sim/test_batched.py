"""The batched simulator: motion, sight and contacts by hand, and worlds that do not mix."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import pack, random_scene, scene, stander, walker

from navrl.ops.raycast import cast_rays
from navrl.sim import BatchedSimulator, Contact, Delays, DifferentialDrive, Lidar
from navrl.worlds import pedestrian_boxes

RADIUS = 0.178


def simulator(num_worlds=1, **arguments):
    arguments = {"robot": DifferentialDrive(), "lidar": Lidar(noise="none")} | arguments
    return BatchedSimulator(num_worlds, **arguments)


def placed(*scenes, **arguments):
    sim = simulator(len(scenes), **arguments)
    sim.reset(torch.arange(len(scenes)), pack(*scenes))
    return sim


def drive(sim, v, w, steps=1):
    for _ in range(steps):
        state = sim.step(torch.tensor([[v, w]]).expand(sim.num_worlds, 2))
    return state


def random_worlds(num_worlds, seed=0, **arguments):
    generator = np.random.default_rng(seed)
    return [random_scene(generator, **arguments) for _ in range(num_worlds)]


def random_commands(num_worlds, steps, seed=0):
    generator = torch.Generator().manual_seed(seed)
    command = torch.rand(steps, num_worlds, 2, generator=generator)
    return command * torch.tensor([1.0, 4.0]) - torch.tensor([0.0, 2.0])


# --- motion --------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["kinematic", "wheeled"])
def test_robots_move_by_the_drive_model(model):
    robot = DifferentialDrive(model=model)
    starts = [(0.1 * i, -0.2 * i, 0.9 * i) for i in range(8)]
    sim = placed(*(scene(start=start) for start in starts), robot=robot)
    pose, velocity = torch.tensor(starts, dtype=torch.float64), torch.zeros(8, 2).double()
    for command in random_commands(8, steps=12):
        state = sim.step(command)
        for _ in range(sim.substeps):
            pose, velocity = robot.advance(pose, velocity, command, 0.02)
        torch.testing.assert_close(state.pose, pose.float(), atol=1e-6, rtol=0)
        torch.testing.assert_close(state.velocity, velocity.float(), atol=1e-6, rtol=0)
    assert state.time_s.tolist() == pytest.approx([2.4] * 8)


def test_wheels_reach_full_speed_in_half_a_second():
    sim = placed(scene(), robot=DifferentialDrive(model="wheeled", wheel_acceleration=2.0))
    speeds = [drive(sim, 1.0, 0.0).velocity[0, 0].item() for _ in range(4)]
    assert speeds == pytest.approx([0.4, 0.8, 1.0, 1.0])
    # the speed holds over each substep: 0.02 s * 0.04 m/s * (1 + ... + 25), then full speed
    assert sim.state().pose[0, 0] == pytest.approx(0.02 * (0.04 * 325 + 15), abs=1e-6)


def test_commands_are_clipped():
    sim = placed(scene())
    state = drive(sim, 5.0, -9.0)
    assert state.velocity[0].tolist() == pytest.approx([1.0, -math.pi])
    assert drive(sim, -5.0, 0.0).velocity[0].tolist() == [0.0, 0.0]


def test_pedestrians_walk_their_routes():
    """For 60 s, hence there and back several times, as the readable form says."""
    scenes = [replace(world, start=np.array([30.0, 0.0, 0.0])) for world in random_worlds(16)]
    sim, batch = placed(*scenes), pack(*scenes)
    before = sim.state().pedestrians
    for step in range(300):
        state = drive(sim, 0.0, 0.0)
        expected = pedestrian_boxes(batch, torch.full((16,), 0.2 * (step + 1)).double())
        got = state.pedestrians[:, : expected.shape[1]]
        turn = (got[..., 4] - expected[..., 4] + math.pi) % (2 * math.pi) - math.pi
        torch.testing.assert_close(
            got[..., :4], expected[..., :4].float(), atol=1e-5, rtol=0, equal_nan=True
        )
        # at the very turning point either heading is right
        assert turn.nan_to_num().abs().gt(1e-4).sum() <= 2
        assert (state.pedestrians[:, :, :2] - before[:, :, :2]).nan_to_num().abs().max() < 0.21
        before = state.pedestrians
    assert state.pedestrians[:, 5:].isnan().all()


# --- contacts by hand ----------------------------------------------------------------------------


def test_head_on_contact_with_a_wall():
    """The wall's face is at 0.5: the disc gets there after 0.322 s, found at the next 0.02 s."""
    sim = placed(scene(boxes=[(0.6, 0.0, 0.1, 2.0, 0.0)]))
    assert drive(sim, 1.0, 0.0).contact[0] == Contact.NONE
    state = drive(sim, 1.0, 0.0)
    assert state.contact[0] == Contact.STATIC
    assert state.pose[0].tolist() == pytest.approx([0.34, 0.0, 0.0], abs=1e-6)
    assert state.time_s[0] == pytest.approx(0.34)


def test_tiny_gap_to_a_wall_is_no_contact():
    for gap, contact in ((1e-6, Contact.NONE), (-1e-6, Contact.STATIC)):
        sim = placed(scene(boxes=[(0.0, RADIUS + gap + 0.1, 5.0, 0.1, 0.0)]))
        assert drive(sim, 0.5, 0.0).contact[0] == contact


@pytest.mark.parametrize(("shift", "contact"), [(1e-4, Contact.NONE), (-1e-4, Contact.STATIC)])
def test_contact_at_a_box_corner_is_exact(shift, contact):
    """The robot is a disc: past a flank at its radius, and no bounding square at a corner."""
    flank = (0.7, RADIUS + shift + 0.2, 0.2, 0.2, 0.0)
    assert drive(placed(scene(boxes=[flank])), 1.0, 0.0, steps=6).contact[0] == contact
    side = (RADIUS + shift) / math.sqrt(2)
    corner = (side + 0.2, -side - 0.2, 0.2, 0.2, 0.0)
    assert drive(placed(scene(boxes=[corner])), 0.0, 1.0).contact[0] == contact


def test_contact_with_a_rotated_box_is_exact():
    """Driving at the corner of a square that stands on its tip."""
    half = 0.3
    sim = placed(scene(boxes=[(1.0, 0.0, half, half, math.pi / 4)]))
    state = drive(sim, 1.0, 0.0, steps=5)
    assert state.contact[0] == Contact.STATIC
    reach = 1.0 - half * math.sqrt(2) - RADIUS
    assert state.pose[0, 0] == pytest.approx(math.ceil(reach / 0.02) * 0.02, abs=1e-6)


def test_robot_moves_into_a_stationary_pedestrian():
    sim = placed(scene(pedestrians=[stander(0.6, 0.0)]))
    state = drive(sim, 1.0, 0.0, steps=3)
    assert state.contact[0] == Contact.PEDESTRIAN
    assert state.pose[0, 0] == pytest.approx(0.28, abs=1e-6)  # 0.6 - 0.15 - 0.178 = 0.272


def test_pedestrian_moves_into_a_stationary_robot():
    sim = placed(scene(pedestrians=[walker((1.0, 0.0), (-1.0, 0.0), speed=1.0)]))
    state = drive(sim, 0.0, 0.0, steps=5)
    assert state.contact[0] == Contact.HIT_BY_PEDESTRIAN
    assert state.time_s[0] == pytest.approx(0.68)  # 1.0 - 0.15 - 0.178 = 0.672
    assert state.pedestrians[0, 0, 0] == pytest.approx(0.32, abs=1e-6)


@pytest.mark.parametrize(
    ("yaw", "v", "contact"),
    [
        (0.0, 0.5, Contact.PEDESTRIAN),  # towards one another
        (0.0, 0.04, Contact.HIT_BY_PEDESTRIAN),  # hardly moving
        (math.pi, 0.5, Contact.HIT_BY_PEDESTRIAN),  # overtaken from behind
        (math.pi / 2 - 0.3, 0.3, Contact.PEDESTRIAN),
        (math.pi / 2 + 0.3, 0.3, Contact.HIT_BY_PEDESTRIAN),
    ],
)
def test_at_fault_party_of_contacts(yaw, v, contact):
    """Somebody comes along x at 1 m/s; the robot drives at v in direction yaw."""
    person = walker((0.7, 0.0), (-3.0, 0.0), half_size=(0.15, 1.0))
    sim = placed(scene(start=(0.0, 0.0, yaw), pedestrians=[person]))
    assert drive(sim, v, 0.0, steps=8).contact[0] == contact


def test_reversing_robot_is_at_fault_behind():
    robot = DifferentialDrive(min_speed=-1.0)
    sim = placed(scene(pedestrians=[stander(-0.6, 0.0)]), robot=robot)
    assert drive(sim, -1.0, 0.0, steps=3).contact[0] == Contact.PEDESTRIAN


@pytest.mark.parametrize(("x", "contact"), [(0.2, Contact.HIT_BY_PEDESTRIAN), (0.25, Contact.NONE)])
def test_contact_between_steps_is_detected(x, contact):
    """Somebody thin crosses ahead within 0.2 s: at neither end of the step does anything touch."""
    person = walker((x, -0.4), (x, 5.0), speed=4.0, half_size=(0.05, 0.05))
    world = scene(pedestrians=[person])
    for time_s in (0.0, 0.2):
        center = pedestrian_boxes(pack(world), torch.tensor([time_s]))[0, 0, :2]
        assert center.norm() - 0.05 * math.sqrt(2) - RADIUS > 0.15
    state = drive(placed(world), 0.0, 0.0)
    assert state.contact[0] == contact
    assert (state.time_s[0] < 0.15) == (contact != Contact.NONE)


def test_contact_priority_of_walls_and_fault():
    wall = (0.5, 0.5, 0.1, 0.3, 0.0)
    ahead, behind = stander(0.45, 0.0), walker((-0.47, 0.0), (3.0, 0.0), speed=1.0)
    for boxes, people, contact in [
        ([(0.4, 0.3, 0.1, 0.3, 0.0)], [stander(0.45, -0.1)], Contact.STATIC),
        ([wall], [ahead], Contact.PEDESTRIAN),
        ([], [behind, ahead], Contact.PEDESTRIAN),
        ([], [ahead, behind], Contact.PEDESTRIAN),
    ]:
        sim = placed(scene(boxes=boxes, pedestrians=people))
        assert drive(sim, 0.5, 0.0, steps=3).contact[0] == contact


def test_contacts_equal_a_fine_search():
    """Random worlds against contact tests in plain torch at every substep."""
    scenes = random_worlds(64, seed=3)
    batch, sim = pack(*scenes), placed(*scenes)
    robot = sim.robot
    pose, velocity = batch.start.clone(), torch.zeros(64, 2).double()
    tick, touched = torch.zeros(64), torch.zeros(64, dtype=torch.bool)
    for command in random_commands(64, steps=25, seed=1) * torch.tensor([1.0, 0.3]):
        for _ in range(10):
            new_pose, new_velocity = robot.advance(pose, velocity, command, 0.02)
            pose = torch.where(touched[:, None], pose, new_pose)
            velocity = torch.where(touched[:, None], velocity, new_velocity)
            tick = torch.where(touched, tick, tick + 1)
            people = pedestrian_boxes(batch, tick.double() * 0.02)
            boxes = torch.cat((batch.boxes, people), dim=1)
            offset = pose[:, None, :2] - boxes[..., :2]
            cos, sin = boxes[..., 4].cos(), boxes[..., 4].sin()
            local = torch.stack(
                (
                    cos * offset[..., 0] + sin * offset[..., 1],
                    cos * offset[..., 1] - sin * offset[..., 0],
                ),
                dim=-1,
            )
            gap = (local.abs() - boxes[..., 2:4]).clamp(min=0).norm(dim=-1)
            touched = touched | (gap <= RADIUS).any(-1)
        state = sim.step(command)
        assert torch.equal(state.contact != Contact.NONE, touched)
        torch.testing.assert_close(state.pose, pose.float(), atol=1e-5, rtol=0)
        torch.testing.assert_close(state.time_s, tick.float() * 0.02, atol=1e-5, rtol=0)
    assert 20 < touched.sum() < 64
    assert len(state.contact.unique()) == 4


def test_world_in_contact_is_frozen_until_reset():
    hit = scene(boxes=[(0.4, 0.0, 0.1, 1.0, 0.0)], pedestrians=[walker((2.0, 0.0), (2.0, 9.0))])
    sim = placed(hit, scene(pedestrians=[walker((2.0, 0.0), (2.0, 9.0))]))
    first, ranges = drive(sim, 0.7, 0.0), sim.ranges()
    assert first.contact.tolist() == [Contact.STATIC, Contact.NONE]
    later = drive(sim, 0.7, 0.5, steps=4)
    for name in ("pose", "velocity", "contact", "pedestrians", "time_s"):
        before, after = getattr(first, name), getattr(later, name)
        assert torch.equal(before[0].nan_to_num(-1), after[0].nan_to_num(-1))
        assert (
            not torch.equal(before[1].nan_to_num(-1), after[1].nan_to_num(-1)) or name == "contact"
        )
    assert torch.equal(ranges[0], sim.ranges()[0])
    assert not torch.equal(ranges[1], sim.ranges()[1])
    sim.reset(torch.tensor([0]), pack(hit))
    state = sim.state()
    assert state.contact[0] == Contact.NONE
    assert state.time_s[0] == 0
    assert state.pose[0, 0] == 0


# --- sight ---------------------------------------------------------------------------------------


def test_ranges_equal_ray_casting():
    """Walls and present pedestrians, from the mount, wherever the robots went."""
    scenes = random_worlds(24, seed=5)
    mount = (0.08, -0.03, 0.4)
    lidar = Lidar(num_beams=360, noise="none", mount=mount)
    sim, batch = placed(*scenes, lidar=lidar), pack(*scenes)
    for command in random_commands(24, steps=8):
        state = sim.step(command)
    pose, cos, sin = state.pose.double(), state.pose[:, 2].cos(), state.pose[:, 2].sin()
    scanner = torch.stack(
        (
            pose[:, 0] + cos * mount[0] - sin * mount[1],
            pose[:, 1] + sin * mount[0] + cos * mount[1],
            pose[:, 2] + mount[2],
        ),
        dim=-1,
    )
    boxes = torch.cat((batch.boxes, state.pedestrians.double()), dim=1)
    expected = cast_rays(scanner, boxes, num_beams=360, backend="torch")
    ranges = sim.ranges()
    assert ranges.dtype == torch.float32
    assert ranges.shape == (24, 360)
    assert (ranges - expected).abs().gt(1e-4).sum() <= 3
    assert (ranges < 3.5).float().mean() > 0.3
    nobody = cast_rays(scanner, batch.boxes, num_beams=360)
    assert (ranges < nobody - 1e-3).any(-1).sum() > 12  # people are seen


@pytest.mark.parametrize("age_s", [0.0, 0.2])
def test_scan_without_pedestrians_shows_the_walls_behind(age_s):
    worlds, delays = random_worlds(4), Delays(scan_age_s=age_s)
    sim = placed(*worlds, delays=delays)
    empty = placed(*(replace(world, pedestrians=()) for world in worlds), delays=delays)
    state = sim.state_dict()
    scans = sim.ranges(), sim.ranges(has_pedestrians=False)
    assert torch.equal(scans[1], empty.ranges()) and bool((scans[0] < scans[1]).any())
    part = torch.tensor([2, 0])
    assert torch.equal(sim.ranges(part, has_pedestrians=False), scans[1][part])
    assert torch.equal(sim.ranges(), scans[0])
    torch.testing.assert_close(sim.state_dict(), state, rtol=0, atol=0, equal_nan=True)


def test_first_scan_is_from_the_start_pose():
    sim = placed(scene(boxes=[(1.0, 0.0, 0.1, 0.1, 0.0)], pedestrians=[stander(0.0, 2.0)]))
    ranges = sim.ranges()[0]
    assert ranges[0] == pytest.approx(0.9)
    assert ranges[360] == pytest.approx(1.85)
    assert ranges[720] == 3.5


def test_noise_of_an_episode_does_not_depend_on_its_row():
    scenes = random_worlds(6)
    one, many = placed(scenes[4]), placed(*scenes)
    lidar, seeds = Lidar(), torch.arange(6) * 7
    for step in range(3):
        drive(one, 0.3, 0.2), drive(many, 0.3, 0.2)
        alone = lidar.add_noise(one.ranges(), seeds[4:5], torch.tensor([step]))
        among = lidar.add_noise(many.ranges(), seeds, torch.full((6,), step))
        assert torch.equal(alone[0], among[4])


# --- worlds that do not mix ----------------------------------------------------------------------


def snapshot(sim):
    state = sim.state()
    return {**vars(state), "ranges": sim.ranges()}


def assert_equal(one, other, rows=slice(None)):
    for name, value in one.items():
        assert torch.equal(value[rows].nan_to_num(-9), other[name][rows].nan_to_num(-9)), name


def test_a_partial_reset_leaves_other_worlds_bit_equal():
    scenes = random_worlds(9)
    sim, undisturbed = placed(*scenes), placed(*scenes)
    others = torch.tensor([0, 2, 3, 4, 6, 8])
    for step, command in enumerate(random_commands(9, steps=10)):
        if step == 4:  # more walls and other people than before
            sim.reset(torch.tensor([7, 1, 5]), pack(*random_worlds(3, seed=9, num_walls=40)))
        sim.step(command), undisturbed.step(command)
        assert_equal(snapshot(sim), snapshot(undisturbed), others)


def test_a_reset_puts_each_scenario_into_its_world():
    sim = placed(*random_worlds(4))
    starts = [(0.1, 0.0, 0.0), (0.2, 0.0, 0.0)]
    sim.reset(torch.tensor([3, 1]), pack(*(scene(start=start) for start in starts)))
    assert sim.state().pose[[3, 1], 0].tolist() == pytest.approx([0.1, 0.2])
    assert sim.state().pedestrians[[3, 1]].isnan().all()
    assert (sim.ranges()[[3, 1]] == 3.5).all()
    sim.reset(
        torch.tensor([], dtype=torch.int64), pack(scene())[torch.tensor([], dtype=torch.int64)]
    )
    assert sim.state().pose[[3, 1], 0].tolist() == pytest.approx([0.1, 0.2])


def test_episode_does_not_depend_on_batch_or_threads():
    scenes = random_worlds(12)
    threads = torch.get_num_threads()
    alone, many = placed(scenes[5]), placed(*scenes)
    try:
        for count, command in enumerate(random_commands(12, steps=10)):
            torch.set_num_threads(1 + count % 2)
            alone.step(command[5:6])
            torch.set_num_threads(1)
            many.step(command)
            assert_equal(
                {name: value[:1] for name, value in snapshot(alone).items()},
                {name: value[5:6] for name, value in snapshot(many).items()},
            )
    finally:
        torch.set_num_threads(threads)


def test_outputs_are_never_views():
    sim = placed(*random_worlds(3))
    state = drive(sim, 0.5, 0.1)
    kept = snapshot(sim)
    copies = {name: value.clone() for name, value in kept.items()}
    drive(sim, 0.5, 0.1)
    assert_equal(kept, copies)
    for value in vars(state).values():
        value.fill_(0)
    assert sim.state().pose.abs().sum() > 0


@pytest.mark.parametrize("model", ["kinematic", "wheeled"])
def test_restored_simulator_continues_bit_for_bit(model):
    scenes, robot = random_worlds(10), DifferentialDrive(model=model)
    sim = placed(*scenes, robot=robot)
    commands = random_commands(10, steps=12)
    for command in commands[:5]:
        sim.step(command)
    sim.reset(torch.tensor([2]), pack(*random_worlds(1, seed=8, num_walls=50)))
    saved = sim.state_dict()
    resumed = simulator(10, robot=robot)
    resumed.load_state_dict(saved)
    for command in commands[5:]:
        sim.step(command), resumed.step(command)
        assert_equal(snapshot(sim), snapshot(resumed))
    resumed.load_state_dict(saved)  # was not written to meanwhile
    assert_equal(resumed.state_dict(), saved)


# --- input that cannot be ------------------------------------------------------------------------


def test_bad_commands_are_named():
    sim = placed(scene(), scene())
    for command, message in [
        (torch.zeros(2, 3), "command: must be"),
        (torch.zeros(3, 2), "command: must be"),
        (torch.full((2, 2), torch.nan), "finite"),
        (torch.full((2, 2), torch.inf), "finite"),
    ]:
        with pytest.raises(ValueError, match=message):
            sim.step(command)
    assert sim.state().time_s.sum() == 0


def test_step_before_a_full_reset_is_rejected():
    sim = simulator(2)
    sim.reset(torch.tensor([0]), pack(scene()))
    with pytest.raises(RuntimeError, match="reset"):
        sim.step(torch.zeros(2, 2))
    with pytest.raises(RuntimeError, match="reset"):
        sim.ranges()
    sim.reset(torch.tensor([1]), pack(scene()))
    sim.step(torch.zeros(2, 2))


@pytest.mark.parametrize(
    ("worlds", "message"),
    [
        ([0, 1], "scenarios: must be 2"),
        ([2], "within"),
        ([-1], "within"),
        ([0.0], "int64"),
        ([[0]], "worlds"),
    ],
)
def test_bad_resets_are_named(worlds, message):
    with pytest.raises(ValueError, match=message):
        simulator(2).reset(torch.tensor(worlds), pack(scene()))


def test_bad_scenarios_are_named():
    with pytest.raises(ValueError, match="distinct"):
        simulator(2).reset(torch.tensor([1, 1]), pack(scene(), scene()))
    with pytest.raises(ValueError, match="max_pedestrians=2: must be at least 3"):
        placed(scene(pedestrians=[stander(2, i) for i in range(3)]), max_pedestrians=2)
    for box in [(1, 0, -0.1, 0.1, 0), (1, 0, 0.1, math.nan, 0), (1, math.inf, 0.1, 0.1, 0)]:
        with pytest.raises(ValueError, match="wall 0 of scenario 0"):
            placed(scene(boxes=[box]))
    with pytest.raises(ValueError, match="start"):
        placed(scene(start=(math.nan, 0, 0)))
    with pytest.raises(ValueError, match="num_worlds"):
        simulator(0)
    with pytest.raises(ValueError, match="pose"):
        simulator(2).load_state_dict(placed(scene()).state_dict())


def test_present_pedestrians_are_compacted():
    """A batch with more rows than the simulator holds fits if few of them are present."""
    people = [stander(1.0, 0.0), stander(2.0, 0.0), stander(3.0, 0.0), stander(0.0, 1.0)]
    batch = pack(scene(pedestrians=people))
    batch.ped_present[0, :2] = False
    sim = simulator(1, max_pedestrians=2)
    sim.reset(torch.tensor([0]), batch)
    assert sim.state().pedestrians[0, :, :2].tolist() == [[3.0, 0.0], [0.0, 1.0]]


def test_a_robot_inside_of_a_wall_is_in_contact_and_sees_zero():
    sim = placed(scene(boxes=[(0.0, 0.0, 0.5, 0.5, 0.3)]))
    assert (sim.ranges() == 0.0).all()
    state = drive(sim, 1.0, 0.0)
    assert state.contact[0] == Contact.STATIC
    assert state.time_s[0] == pytest.approx(0.02)


def test_a_large_batch_is_small_in_memory():
    sim = simulator(4096)
    total = sum(value.nbytes for value in sim.state_dict().values()) + sim._near.nbytes
    assert total < 60e6


def test_compiling_is_announced_once(caplog, tmp_path, monkeypatch):
    """And never with a kernel that is in the cache."""
    from navrl.ops.kernels import compiler

    monkeypatch.setattr(compiler, "cache_directory", lambda: str(tmp_path))

    def double(rows, values):
        for index in range(rows[0], rows[1]):
            values[index] *= 2

    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            values = np.ones(3)
            compiler.kernel(double)(values)
            assert values.tolist() == [2, 2, 2]
    assert sum("compiling double" in message for message in caplog.messages) == 1
