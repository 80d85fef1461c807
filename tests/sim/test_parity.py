"""The batched simulator and PyBullet play the same episodes.

Three pieces of geometry are written twice, by navrl and by PyBullet: what a beam meets, whether the
disc touches a box, and where. All of it is compared at every step of every episode, through partial
resets, for drivers who meet walls and people.
"""

import math
from dataclasses import dataclass, field

import pytest
import torch
from episodes import Drivers, sample
from hydra.utils import instantiate
from models import Fleeing, Omnidirectional
from nightly import mostly

from navrl.config import compose
from navrl.ops import se2
from navrl.sim import (
    BatchedSimulator,
    Contact,
    Delays,
    DifferentialDrive,
    Lidar,
    LimitedDrive,
    Uniform,
)
from navrl.worlds import ScenarioBatch

pytest.importorskip("pybullet")
from navrl.sim import BulletSimulator

KINDS = ("corridor", "intersection", "office", "clutter")
MODELS = ("kinematic", "wheeled")
RANGE_BOUND = 1e-3  # m
POSE_BOUND = 1e-4  # m and rad
VARIED = Delays(
    scan_age_s=Uniform(0.0, 0.3),
    speed_delay_s=0.04,
    command_delay_s=Uniform(0.0, 0.3),
    revolution_s=Uniform(0.0, 0.2),
    scan_jitter_s=0.1,
    command_jitter_s=Uniform(0.02, 0.3),
)
CLOCKWISE = Lidar(num_beams=181, noise="none", angle_min=2.9, angle_increment=-0.0312)
EDGE = 1e-3  # m; PyBullet's faces reach 1e-4 of their length beyond their edges and stop such beams
LIMITED = LimitedDrive(
    min_speed=-0.3,
    linear_acceleration=0.8,
    linear_deceleration=1.2,
    angular_acceleration=6.0,
    angular_deceleration=9.0,
    wheel_acceleration=1.0,
    linear_lag_s=0.1,
    angular_lag_s=0.06,
    linear_scale=1.1,
    angular_scale=0.9,
    linear_bias=0.02,
    angular_bias=-0.05,
    speed_cap=0.8,
    turn_rate_cap=2.5,
)
VARIED_ROBOT = instantiate(compose(None, ["+robot@node=varied"]).node)


@dataclass
class Tally:
    """What a comparison came to."""

    episodes: int
    beams: int = 0
    differing: int = 0  # beams beyond the bound, each of which passes an edge in grazing
    worst_range: float = 0.0  # m, of the other beams
    worst_pose: float = 0.0  # m or rad
    contacts: list[int] = field(default_factory=lambda: [0] * len(Contact))


def play_on_both(scenarios, robot=None, lidar=None, num_worlds=12, max_steps=40, **options):
    """Play each scenario on both simulators, compare after every step, and return the tally.

    An episode ends after ``max_steps``, or within eight steps of its contact, in which nothing may
    move. Worlds are reset to the next scenarios one by one.
    """
    robot, lidar = robot or DifferentialDrive(), lidar or Lidar(noise="none")
    waiting, tally = list(scenarios), Tally(episodes=len(scenarios))
    num_worlds = min(num_worlds, len(waiting))
    drivers = Drivers(num_worlds, seed=len(waiting))
    playing = [waiting[0]] * num_worlds
    age, path = torch.full((num_worlds,), max_steps), torch.zeros(num_worlds, 200, 2)
    fast = BatchedSimulator(num_worlds, robot, lidar, **options)
    with BulletSimulator(num_worlds, robot, lidar, **options) as checked:
        while True:
            ended = (age >= max_steps) | ((fast.state().contact != 0) & (age % 8 == 7))
            if bool(ended.all()) and not waiting:
                return tally
            worlds = ended.nonzero().flatten()[: len(waiting)]
            if len(worlds):
                for world in worlds.tolist():
                    playing[world] = waiting.pop()
                batch = ScenarioBatch.pack([playing[world] for world in worlds])
                fast.reset(worlds, batch)
                checked.reset(worlds, batch)
                path[worlds], age[worlds] = batch.path, 0
                drivers.change(worlds)
            compare_ranges(tally, fast, checked, playing)
            motion, wanted = fast.scan_motion(), checked.scan_motion()
            torch.testing.assert_close(motion, wanted, atol=POSE_BOUND, rtol=0)
            free = fast.state().contact == 0
            command = drivers.command(fast.state().pose, path)
            command = torch.nn.functional.pad(command, (0, robot.command_size - 2))
            compare_states(tally, fast.step(command), checked.step(command))
            for contact in fast.state().contact[free].tolist():
                tally.contacts[contact] += 1
            age += 1


def compare_states(tally, fast, checked):
    """Same contact in the same substep, at the same place."""
    assert fast.contact.tolist() == checked.contact.tolist()
    assert torch.equal(fast.time_s, checked.time_s)
    for name in ("pose", "velocity", "pedestrians"):
        got, wanted = getattr(fast, name), getattr(checked, name)
        torch.testing.assert_close(got, wanted, atol=POSE_BOUND, rtol=0, equal_nan=True)
    tally.worst_pose = max(tally.worst_pose, (fast.pose - checked.pose).abs().max().item())


def compare_ranges(tally, fast, checked, playing):
    """Same ranges but for beams that graze an edge."""
    ranges, wanted = fast.ranges(), checked.ranges()
    error = (ranges - wanted).abs()
    differs = error > RANGE_BOUND
    for world, beam in differs.nonzero().tolist():
        seen = wanted[world, beam].item()
        message = (
            f"beam {beam} of world {world} grazes no edge, but reads {ranges[world, beam]:.4f} m "
            f"in the batched simulator and {seen:.4f} m in PyBullet"
        )
        assert seen < ranges[world, beam], message
        assert clearance_of_corners(fast, playing[world], world, beam, seen) < EDGE, message
    tally.beams += error.numel()
    tally.differing += int(differs.sum())
    tally.worst_range = max(tally.worst_range, error[~differs].max().item())


def clearance_of_corners(simulator, scenario, world, beam, distance):
    """Return how far a beam passes from the nearest corner of a box up to ``distance``, m."""
    state, lidar = simulator.state(), simulator.lidar
    pose, people = state.pose[world].double(), state.pedestrians[world].double()
    memory = simulator.scan_memory
    if memory.is_used:
        sweep = int(memory.sweep[world])
        later = sweep - math.floor(0.5 + sweep * beam / (lidar.num_beams - 1))  # substeps
        entry = (int(memory.newest[world]) - later) % memory.length
        pose, people = (memory.rows[name][world, entry] for name in ("pose", "boxes"))
    walls = torch.tensor(scenario.boxes, dtype=torch.float64)
    boxes = torch.cat((walls, people[:, :5]))
    signs = torch.tensor([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]).double()
    corners = signs * boxes[:, None, 2:4]  # [boxes, 4, 2], each in its box's frame
    corners = se2.transform_points(boxes[:, [0, 1, 4]], corners).flatten(0, 1)
    mount = torch.tensor([*lidar.mount], dtype=torch.float64)
    turn = torch.stack((torch.tensor(0.0), torch.tensor(0.0), lidar.beam_angles()[beam])).double()
    ray = se2.compose(se2.compose(pose, mount), turn)
    along, across = se2.transform_points(se2.inverse(ray), corners).unbind(-1)
    met = (along > 0.0) & (along < distance + EDGE)
    return torch.where(met, across.abs(), torch.inf).min().item()


def check_variety(tally):
    """The episodes must have been worth comparing."""
    assert tally.contacts[Contact.STATIC] >= tally.episodes / 10
    assert tally.contacts[Contact.PEDESTRIAN] >= tally.episodes / 20
    assert tally.contacts[Contact.HIT_BY_PEDESTRIAN] >= tally.episodes / 20
    assert tally.differing <= 5e-4 * tally.beams


@pytest.mark.parametrize("model", MODELS)
def test_simulators_agree_on_episodes(model):
    scenarios = [sample(kind, index) for kind in KINDS for index in range(8)]
    tally = play_on_both(scenarios, DifferentialDrive(model=model), max_steps=25)
    check_variety(tally)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_simulators_agree_on_hundreds_of_episodes(kind):
    scenarios = [sample(kind, index) for index in range(75)]
    for model in MODELS:
        tally = play_on_both(scenarios, DifferentialDrive(model=model), max_steps=80)
        print(kind, model, tally)
        assert tally.differing <= 5e-4 * tally.beams


def test_simulators_agree_with_another_robot_and_lidar():
    """A backing robot, a turned lidar outside of its hull and above the usual walls, few beams."""
    robot = DifferentialDrive(radius=0.3, min_speed=-0.5, max_speed=1.5, model="wheeled")
    lidar = Lidar(num_beams=181, max_range=6.0, mount=(0.35, -0.1, 2.0), height=1.5, noise="none")
    scenarios = [sample("clutter", 1000 + index) for index in range(16)]
    tally = play_on_both(scenarios, robot, lidar, time_step_s=0.1, substeps=4)
    assert sum(tally.contacts[1:]) > 4


MODELS = {
    "270 degrees": {
        "lidar": Lidar(num_beams=271, noise="none", angle_min=-2.4, angle_increment=0.0177)
    },
    "clockwise from behind": {"lidar": CLOCKWISE},
    "base": {"robot": Omnidirectional()},
    "limited base": {"robot": LIMITED},
    "varied bases": {"robot": VARIED_ROBOT, "delays": Delays(speed_delay_s=0.1)},
    "pedestrians": {"pedestrians": Fleeing()},
    "delays": {"delays": Delays(scan_age_s=0.06, speed_delay_s=0.1, turn_rate_delay_s=0.24)},
    "delays and pedestrians": {
        "delays": Delays(scan_age_s=0.3),
        "pedestrians": Fleeing(speed=1.0),
    },
    "drawn delays": {
        "delays": Delays(scan_age_s=Uniform(0.0, 0.3), command_delay_s=Uniform(0.0, 0.3))
    },
    "spinning lidar": {
        "delays": Delays(revolution_s=0.2),
        "lidar": Lidar(num_beams=271, noise="none"),
    },
    "varied": {"delays": VARIED, "robot": DifferentialDrive(model="wheeled")},
    "varied, base and pedestrians": {
        "delays": VARIED,
        "robot": Omnidirectional(),
        "pedestrians": Fleeing(),
    },
    "varied, period and lidar": {
        "time_step_s": 0.4,
        "substeps": 20,
        "lidar": CLOCKWISE,
        "delays": VARIED,
    },
}
BY_DAY = ["limited base", "pedestrians", "drawn delays", "varied, period and lidar"]


@pytest.mark.parametrize("name", mostly(MODELS, BY_DAY))
def test_simulators_agree_with_other_models(name):
    scenarios = [sample(kind, 40 + index) for kind in KINDS for index in range(4)]
    tally = play_on_both(scenarios, max_steps=25, **MODELS[name])
    assert sum(tally.contacts[1:]) > 2
    assert tally.differing <= 5e-4 * tally.beams
