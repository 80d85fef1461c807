"""The PyBullet simulator: what it sees, what it holds, and how it ends."""

import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from episodes import sample
from scenes import pack, scene, stander, walker

from navrl.sim import Contact, DifferentialDrive, Lidar

pytest.importorskip("pybullet")
from navrl.sim import BulletSimulator

RADIUS = 0.178
WALL_AHEAD = (2.0, 0.0, 0.1, 3.0, 0.0)  # its face is at x = 1.9


@pytest.fixture
def place():
    """Build simulators of hand-made scenes, and close them in the end."""
    opened = []

    def build(*scenes, **arguments):
        arguments = {"robot": DifferentialDrive(), "lidar": Lidar(noise="none")} | arguments
        opened.append(BulletSimulator(len(scenes), **arguments))
        opened[-1].reset(torch.arange(len(scenes)), pack(*scenes))
        return opened[-1]

    yield build
    for simulator in opened:
        simulator.close()


def drive(simulator, v, w, steps=1):
    for _ in range(steps):
        state = simulator.step(torch.tensor([[v, w]]).expand(simulator.num_worlds, 2))
    return state


# --- sight ---------------------------------------------------------------------------------------


def test_ranges_equal_closed_forms(place):
    """A wall 1.9 m ahead reads 1.9 / cos(angle), up to its ends; all else reads the maximum."""
    lidar = Lidar(noise="none")
    ranges = place(scene([WALL_AHEAD]), lidar=lidar).ranges()[0].double()
    angle = lidar.beam_angles()
    wanted = torch.where(angle.cos() > 0, 1.9 / angle.cos(), 3.5).clamp(max=3.5)
    edge = (1.9 * angle.tan() - 3.0).abs() < 0.01
    torch.testing.assert_close(ranges[~edge], wanted[~edge], atol=1e-6, rtol=0)
    assert int((ranges == 3.5).sum()) == int((wanted == 3.5).sum())


def test_scan_shows_moving_pedestrians(place):
    simulator = place(scene(pedestrians=[walker((1.0, 0.0), (3.0, 0.0), speed=0.5)]))
    assert simulator.ranges()[0, 0].item() == pytest.approx(0.85, abs=1e-6)
    drive(simulator, 0.0, 0.0, steps=5)
    assert simulator.ranges()[0, 0].item() == pytest.approx(1.35, abs=1e-6)
    assert simulator.state().pedestrians[0, 0].tolist() == pytest.approx([1.5, 0, 0.15, 0.15, 0])


def test_the_robot_is_never_seen(place):
    """A lidar behind the hull, looking through it, sees the wall beyond."""
    lidar = Lidar(noise="none", mount=(-0.5, 0.0, 0.0), height=0.3)
    ranges = place(scene([WALL_AHEAD]), lidar=lidar).ranges()[0]
    assert ranges[0].item() == pytest.approx(2.4, abs=1e-6)
    assert int((ranges < 2.3).sum()) == 0


def test_mount_turns_and_shifts_the_scan(place):
    """On a robot that faces up, a mount 0.2 m to its left looks right, which is along x."""
    lidar = Lidar(noise="none", mount=(0.0, 0.2, -math.pi / 2))
    ranges = place(scene([WALL_AHEAD], start=(0.0, 0.0, math.pi / 2)), lidar=lidar).ranges()[0]
    assert ranges[0].item() == pytest.approx(2.1, abs=1e-6)


@pytest.mark.parametrize("height", [0.05, 0.5, 1.1, 3.0])
def test_obstacles_reach_up_to_the_lidar(place, height):
    lidar = Lidar(noise="none", height=height)
    people = [stander(-1.0, 0.0)]
    simulator = place(scene([WALL_AHEAD], pedestrians=people), lidar=lidar)
    assert simulator.ranges()[0, [0, 720]].tolist() == pytest.approx([1.9, 0.85], abs=1e-6)
    assert drive(simulator, 1.0, 0.0, steps=10).contact.item() == Contact.STATIC


def test_a_lidar_inside_of_a_box_reads_zero(place):
    thick = (0.0, 0.0, 2.0, 2.0, 0.3)
    simulator = place(scene([thick]), scene(pedestrians=[stander(0.0, 0.0)]), scene())
    assert simulator.ranges().amax(1).tolist() == [0.0, 0.0, 3.5]
    contact = drive(simulator, 0.0, 0.0).contact
    assert contact.tolist() == [Contact.STATIC, Contact.HIT_BY_PEDESTRIAN, Contact.NONE]


def test_scans_with_many_beams_use_several_requests(place):
    lidar = Lidar(num_beams=20_000, noise="none")
    ranges = place(scene([WALL_AHEAD]), lidar=lidar).ranges()
    assert ranges.shape == (1, 20_000)
    assert ranges[0, 0].item() == pytest.approx(1.9, abs=1e-6)
    assert ranges[0, -1].item() == pytest.approx(1.9, abs=1e-5)


# --- contact -------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap, contact", [(1e-6, Contact.NONE), (-1e-6, Contact.STATIC)])
@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_contact_distance_is_exact(place, gap, contact, yaw):
    """A disc beside a face, and beside a corner, to a micrometre: no collision margin."""
    x, y = 0.4 * math.cos(yaw), 0.4 * math.sin(yaw)
    reach = RADIUS + gap
    face = scene([(x, y, 0.4 - reach, 0.3, yaw)])
    diagonal = reach / math.sqrt(2.0)
    ahead = 0.2 + diagonal
    corner = (
        ahead * math.cos(yaw) - ahead * math.sin(yaw),
        ahead * math.sin(yaw) + ahead * math.cos(yaw),
    )
    simulator = place(face, scene([(*corner, 0.2, 0.2, yaw)]))
    assert drive(simulator, 0.0, 0.0).contact.tolist() == [contact, contact]


def test_contacts_are_classified_and_freeze_the_world(place):
    ahead, behind = stander(0.45, 0.0), walker((-0.6, 0.0), (3.0, 0.0), speed=1.0)
    simulator = place(
        scene(pedestrians=[ahead]), scene(pedestrians=[behind]), scene([(0.5, 0.0, 0.1, 1.0, 0.0)])
    )
    command = torch.tensor([[1.0, 0.0], [0.0, 0.0], [0.5, 0.0]])
    for _ in range(4):
        state = simulator.step(command)
    assert state.contact.tolist() == [Contact.PEDESTRIAN, Contact.HIT_BY_PEDESTRIAN, Contact.STATIC]
    # 0.45 - 0.15 - 0.178 = 0.122 m away: reached at the 7th substep of 0.02 m
    assert state.time_s.tolist() == pytest.approx([0.14, 0.28, 0.46])
    assert state.pose[0].tolist() == pytest.approx([0.14, 0.0, 0.0])
    assert state.pedestrians[1, 0, 0].item() == pytest.approx(-0.6 + 0.28)
    again = simulator.step(command)
    assert torch.equal(again.pose, state.pose)
    assert torch.equal(again.time_s, state.time_s)


# --- state ---------------------------------------------------------------------------------------


def random_step(simulator, generator):
    return simulator.step(torch.rand(simulator.num_worlds, 2, generator=generator))


def assert_same(a, b):
    for name, value in vars(a).items():
        assert torch.equal(value.nan_to_num(9.0), getattr(b, name).nan_to_num(9.0)), name


def test_restored_simulator_continues_bit_for_bit(place):
    scenes = [sample("corridor", 0), sample("clutter", 1), sample("office", 2)]
    robot = DifferentialDrive(model="wheeled")
    simulator, other = place(*scenes, robot=robot), place(*reversed(scenes), robot=robot)
    generator = torch.Generator().manual_seed(3)
    for _ in range(5):
        random_step(simulator, generator)
    other.load_state_dict(simulator.state_dict())
    simulator.reset(torch.tensor([1]), pack(sample("intersection", 3)))
    other.reset(torch.tensor([1]), pack(sample("intersection", 3)))
    fork = generator.clone_state()
    for _ in range(15):
        assert_same(random_step(simulator, generator), random_step(other, fork))
        assert torch.equal(simulator.ranges(), other.ranges())


def test_state_is_loaded_before_the_first_reset(place):
    fresh = BulletSimulator(1, DifferentialDrive(), Lidar())
    used = place(scene())
    used.load_state_dict(fresh.state_dict())
    with pytest.raises(RuntimeError, match="reset"):
        used.step(torch.zeros(1, 2))


def test_state_of_another_simulator_is_rejected(place):
    one, two = place(scene()), place(scene(), scene())
    with pytest.raises(ValueError, match="pose"):
        one.load_state_dict(two.state_dict())
    with pytest.raises(ValueError, match=r"scenario\.ped_present"):
        one.load_state_dict(place(scene(), max_pedestrians=3).state_dict())


def test_partial_reset_leaves_other_worlds_unchanged(place):
    simulator, alone = place(sample("corridor", 5), scene()), place(sample("corridor", 5))
    generator = torch.Generator().manual_seed(4)
    for index in range(12):
        if index % 3 == 0:
            simulator.reset(torch.tensor([1]), pack(sample("clutter", index)))
        command = torch.rand(2, 2, generator=generator)
        simulator.step(command)
        alone.step(command[:1])
        assert torch.equal(simulator.ranges()[0], alone.ranges()[0])
    assert torch.equal(simulator.state().pose[0], alone.state().pose[0])


def test_outputs_are_never_views(place):
    simulator = place(scene([WALL_AHEAD], pedestrians=[stander(-1.0, 0.0)]))
    for tensor in (*vars(simulator.state()).values(), simulator.ranges()):
        tensor.fill_(7)
    for tensor in simulator.state_dict().values():
        tensor.fill_(1)
    assert simulator.state().pose.abs().sum() == 0
    assert simulator.ranges()[0, 0].item() == pytest.approx(1.9, abs=1e-6)


# --- what it holds -------------------------------------------------------------------------------


def memory_mb():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_repeated_resets_do_not_leak_memory(place, monkeypatch):
    """PyBullet leaks with every body removed: 300 resets would take 70 MB without fresh starts."""
    monkeypatch.setattr("navrl.sim.bullet.MAX_REMOVED_BODIES", 1000)
    simulator = place(sample("clutter", 0), sample("corridor", 1))
    drive(simulator, 0.2, 0.5, steps=3)
    seen = simulator.ranges()[1]
    batches = [pack(sample("clutter", index)) for index in range(10)]
    counts, memory = [], []
    for repeat in range(300):
        simulator.reset(torch.tensor([0]), batches[repeat % 10])
        if repeat % 10 == 9:
            counts.append(simulator._client.getNumBodies())
            memory.append(memory_mb())
            assert torch.equal(simulator.ranges()[1], seen)  # fresh starts leave no trace
    assert len(set(counts)) == 1
    assert memory[-1] - memory[4] < 30.0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_worlds_and_closed_simulators_use_little_memory():
    before = memory_mb()
    for _ in range(10):
        with BulletSimulator(32, DifferentialDrive(), Lidar()) as simulator:
            simulator.reset(torch.arange(32), pack(*[scene([WALL_AHEAD])] * 32))
    assert memory_mb() - before < 150.0


def test_closed_simulator_raises(place):
    simulator = place(scene())
    simulator.close()
    simulator.close()
    for use in (simulator.ranges, lambda: drive(simulator, 0.0, 0.0), simulator.render):
        with pytest.raises(RuntimeError, match="closed"):
            use()


def test_interpreter_exits_cleanly_with_an_open_simulator():
    code = (
        "from navrl.sim import BulletSimulator, DifferentialDrive, Lidar;"
        "simulator = BulletSimulator(1, DifferentialDrive(), Lidar())"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    lines = [line for line in result.stderr.splitlines() if "pybullet build time" not in line]
    assert (result.returncode, lines) == (0, [])


# --- pictures ------------------------------------------------------------------------------------


def quarters_that_differ(picture, other):
    """Return in which quarters two square pictures differ: (is lower, is right)."""
    differs = (picture != other).any(-1)
    assert differs.sum() > 20
    return {(row >= 80, column >= 80) for row, column in np.argwhere(differs).tolist()}


def test_render_shows_robot_and_pedestrian_where_they_are(place):
    room = [(x, 0.0, 0.05, 2.0, 0.0) for x in (-2.0, 2.0)]
    room += [(0.0, y, 2.0, 0.05, 0.0) for y in (-2.0, 2.0)]
    simulator = place(
        scene(room, start=(1.0, -1.2, 0.0)),
        scene(room, start=(1.0, -1.2, 0.0), pedestrians=[stander(-1.0, 0.8)]),
        scene(room, start=(1.0, -0.8, 0.0)),
    )
    picture, peopled, moved = (simulator.render(world, 160, 160) for world in range(3))
    assert picture.shape == (160, 160, 3)
    assert picture.dtype == np.uint8
    assert quarters_that_differ(picture, peopled) == {(False, False)}
    assert quarters_that_differ(picture, moved) == {(True, True)}
    assert np.array_equal(picture, simulator.render(0, 160, 160))


# --- what goes wrong -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["num_worlds", "time_step_s", "substeps", "max_pedestrians"])
def test_bad_arguments_are_named(name):
    arguments = {"num_worlds": 1, "robot": DifferentialDrive(), "lidar": Lidar()} | {name: 0}
    with pytest.raises(ValueError, match=name):
        BulletSimulator(**arguments)


def test_a_window_needs_a_display(monkeypatch):
    for display, message in (("", "DISPLAY is not set"), (":987", "none responds at DISPLAY=:987")):
        monkeypatch.setenv("DISPLAY", display)
        monkeypatch.setattr(sys, "platform", "linux")
        with pytest.raises(RuntimeError, match=message):
            BulletSimulator(1, DifferentialDrive(), Lidar(), gui=True)


def test_missing_pybullet_is_named():
    code = "import sys; sys.modules['pybullet'] = None; from navrl.sim import BulletSimulator"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "pip install pybullet" in result.stderr.splitlines()[-1]


def test_step_before_a_full_reset_is_rejected():
    with BulletSimulator(2, DifferentialDrive(), Lidar()) as simulator:
        simulator.reset(torch.tensor([1]), pack(scene()))
        for use in (simulator.ranges, lambda: drive(simulator, 0.0, 0.0)):
            with pytest.raises(RuntimeError, match="reset"):
                use()
        assert simulator.state().contact.tolist() == [0, 0]


def test_bad_input_is_named(place):
    simulator = place(scene())
    with pytest.raises(ValueError, match=r"\[1, 2\]"):
        simulator.step(torch.zeros(2, 2))
    with pytest.raises(ValueError, match="finite"):
        drive(simulator, math.nan, 0.0)
    with pytest.raises(ValueError, match="wall 0"):
        simulator.reset(torch.tensor([0]), pack(scene([(1.0, 0.0, -0.1, 1.0, 0.0)])))


def test_skipped_world_is_frozen(place):
    walk = walker((1.0, 0.0), (3.0, 0.0), speed=0.5)
    simulator = place(scene(pedestrians=[walk]), scene(pedestrians=[walk]))
    drive(simulator, 0.2, 0.0)
    rested, before = simulator.state(), simulator.ranges()
    simulator.skip(torch.tensor([True, False]))
    drive(simulator, 0.2, 0.0, steps=3)
    after = simulator.state()
    for then, now in (
        (rested.pose, after.pose),
        (rested.time_s, after.time_s),
        (rested.pedestrians[:, 0], after.pedestrians[:, 0]),
    ):
        assert torch.equal(then[0], now[0]) and not torch.equal(then[1], now[1])
    assert torch.equal(simulator.ranges()[0], before[0])
    assert not torch.equal(simulator.ranges()[1], before[1])
    simulator.reset(torch.tensor([0]), pack(scene(pedestrians=[walk])))
    drive(simulator, 0.2, 0.0)
    torch.testing.assert_close(simulator.state().pose[0], rested.pose[0])
    assert simulator.ranges()[0, 0] == before[0, 0]


def test_rendering_changes_no_result(place):
    walk = walker((1.0, 0.0), (3.0, 0.0), speed=0.5)
    looked_at, alone = (place(scene([WALL_AHEAD], pedestrians=[walk])) for _ in range(2))
    for _ in range(4):
        assert looked_at.render(0, 64, 48).std() > 0
        one, other = drive(looked_at, 0.3, 0.4), drive(alone, 0.3, 0.4)
        assert torch.equal(one.pose, other.pose) and torch.equal(one.contact, other.contact)
        assert torch.equal(looked_at.ranges(), alone.ranges())
