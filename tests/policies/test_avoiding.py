"""Controllers that see: scans by hand, and what must be done about them."""

import importlib.util
import math
import sys

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from navrl import keys
from navrl.policies.classical import DynamicWindow, Orca, StopAndGo
from navrl.policies.classical.commands import last_command, normalized_action, physical_command
from navrl.sim import DifferentialDrive
from navrl.worlds import Pedestrian, Scenario, ScenarioBatch

ROBOT = DifferentialDrive()
AHEAD = torch.stack([0.3 * torch.arange(1.0, 6.0), torch.zeros(5)], dim=-1)  # waypoints


def disc(x, y, radius=0.15, count=24):
    """Points on the near side of somebody, as a lidar sees them."""
    angle = torch.linspace(0, 2 * math.pi, count + 1)[:-1]
    points = torch.stack([x + radius * angle.cos(), y + radius * angle.sin()], dim=-1)
    return points[points.norm(dim=-1) <= math.hypot(x, y)]


def scan(*parts, motion=(0.0, 0.0), at=None, waypoints=AHEAD):
    """An observation of one world; ``motion`` m a step of the group at ``at``."""
    found = torch.cat(parts) if parts else torch.zeros(0, 2)
    points = torch.cat([found, 3.5 * torch.ones(180 - len(found), 2)])
    tagd = torch.full((30, 4), 3.0)
    valid = torch.zeros(30, 2, dtype=torch.bool)
    if at is not None:
        now = torch.tensor(at)
        tagd[0], valid[0] = torch.cat([now - torch.tensor(motion), now]), True
    values = {
        keys.POINTS: points,
        keys.RETURNS: torch.arange(180) < len(found),
        keys.WAYPOINTS: waypoints,
        keys.TAGD: tagd,
        keys.TAGD_VALID: valid,
    }
    return TensorDict({name: value[None] for name, value in values.items()}, [1])


def drive(policy, observation):
    action = policy(observation)[keys.ACTION]
    assert bool((action.abs() <= 1).all())
    return physical_command(policy.robot, action)[0].tolist()


def test_commands_round_trip_through_scaling():
    robot = DifferentialDrive(min_speed=-0.25, max_speed=0.75, max_turn_rate=2.0)
    command = torch.tensor([[-0.25, 2.0], [0.1, -0.3], [0.75, 0.0]])
    torch.testing.assert_close(physical_command(robot, normalized_action(robot, command)), command)
    clipped = normalized_action(robot, torch.tensor([9.0, -9.0]))
    assert clipped.tolist() == [1.0, -1.0]


def test_last_command_is_within_the_limits_of_the_robot():
    action = torch.tensor([[3.0, -math.inf], [math.nan, 0.5], [-1.0, 1.0]])
    command = last_command(ROBOT, TensorDict({keys.ACTION: action}, [3]))
    expected = [[1.0, -math.pi], [0.0, math.pi / 2], [0.0, math.pi]]
    torch.testing.assert_close(command, torch.tensor(expected))
    assert last_command(ROBOT, TensorDict({}, [3])).tolist() == [[0.0, 0.0]] * 3


# --- dynamic window ------------------------------------------------------------------------------


@pytest.mark.parametrize("predict", [False, True])
def test_window_drives_at_full_speed_in_free_space(predict):
    v, w = drive(DynamicWindow(ROBOT, predict), scan())
    assert (v, w) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-5))


@pytest.mark.parametrize("side", [1, -1])
def test_window_passes_obstacles_on_the_free_side(side):
    wall = torch.stack([torch.linspace(0.2, 1.5, 30), torch.full((30,), 0.35 * side)], dim=-1)
    v, w = drive(DynamicWindow(ROBOT), scan(disc(0.9, 0.05 * side), wall))
    assert v > 0
    assert w * side < 0


def test_window_does_not_drive_into_a_wall():
    wall = torch.stack([torch.full((100,), 0.3), torch.linspace(-2.0, 2.0, 100)], dim=-1)
    v, _ = drive(DynamicWindow(ROBOT), scan(wall))
    assert v * ROBOT.radius < 0.3 * 0.2  # next to nothing


def test_window_follows_the_waypoints_to_the_side():
    for side in (1, -1):
        points = AHEAD @ torch.tensor([[0.6, 0.8 * side], [0.0, 0.0]])
        _, w = drive(DynamicWindow(ROBOT), scan(waypoints=points))
        assert w * side > 0


def test_window_heads_for_the_last_waypoint():
    bend = torch.tensor([[0.3, 0.0], [0.6, 0.0], [0.6, 0.3], [0.6, 0.6], [0.6, 0.9]])
    _, w = drive(DynamicWindow(ROBOT, path_weight=0.0), scan(waypoints=bend))
    assert w > 0.5


def test_path_weight_keeps_arcs_near_the_path():
    """The last waypoint is beyond the horizon: the nearest end to it lies off the path."""
    bend = torch.tensor([[0.6, 0.0], [1.2, 0.0], [1.8, 0.0], [1.8, 0.9], [1.8, 1.8]])
    _, cuts = drive(DynamicWindow(ROBOT, path_weight=0.0), scan(waypoints=bend))
    _, follows = drive(DynamicWindow(ROBOT, path_weight=5.0), scan(waypoints=bend))
    assert cuts > 0.5
    assert follows < cuts - 0.2


@pytest.mark.parametrize(("margin", "passes"), [(0.05, False), (0.0, True)])
def test_window_margin_excludes_arcs(margin, passes):
    """A wall 0.03 m beside the hull."""
    wall = torch.stack([torch.linspace(-0.5, 2.0, 120), torch.full((120,), 0.208)], dim=-1)
    policy = DynamicWindow(ROBOT, margin=margin, clearance_weight=0.0)
    _, w = drive(policy, scan(wall))
    assert (w == pytest.approx(0.0, abs=1e-5)) is passes


def test_excess_clearance_adds_no_score():
    wall = torch.stack([torch.linspace(-0.5, 2.0, 120), torch.full((120,), 0.6)], dim=-1)
    policy = DynamicWindow(ROBOT, clearance_weight=50.0)
    assert drive(policy, scan(wall)) == pytest.approx([1.0, 0.0], abs=1e-5)
    _, w = drive(DynamicWindow(ROBOT, clearance_weight=50.0, clearance=2.0), scan(wall))
    assert w < -0.1


def test_window_rejects_arcs_with_a_contact_midway():
    """A post 0.3 m ahead: clear again from the third step on, were it not for the first two."""
    post = torch.tensor([[0.3, 0.0]])
    v, w = drive(DynamicWindow(ROBOT), scan(post))
    for step in range(1, 71):  # 1.4 s
        half = 0.5 * w * 0.02 * step
        chord = v * 0.02 * step * float(np.sinc(half / math.pi))
        assert math.dist((chord * math.cos(half), chord * math.sin(half)), (0.3, 0.0)) > 0.178


def arcs_end_clear(policy, observation, walker, velocity):
    """Whether the commanded arc stays clear of a disc that walks on."""
    v, w = drive(policy, observation)
    for step in range(1, 5):
        half = 0.5 * w * 0.2 * step
        chord = v * 0.2 * step * float(np.sinc(half / math.pi))
        gap = math.dist(
            (chord * math.cos(half), chord * math.sin(half)),
            (walker[0] + velocity[0] * step, walker[1] + velocity[1] * step),
        )
        if gap <= ROBOT.radius + 0.15:
            return False
    return True


def test_only_the_prediction_avoids_crossing_pedestrians():
    """Somebody 0.8 m to the side comes across: where the robot would be in 0.6 s."""
    person, motion = (0.7, 0.8), (0.0, -0.2)
    observation = scan(disc(*person), motion=motion, at=person)
    assert not arcs_end_clear(DynamicWindow(ROBOT), observation.clone(), person, motion)
    assert arcs_end_clear(DynamicWindow(ROBOT, True), observation.clone(), person, motion)


@pytest.mark.parametrize("motion", [(0.0, -0.03), (0.0, -0.5)])
def test_noise_and_mismatches_are_static(motion):
    observation = scan(disc(0.7, 0.8), motion=motion, at=(0.7, 0.8))
    blind, seeing = DynamicWindow(ROBOT), DynamicWindow(ROBOT, True)
    assert drive(seeing, observation.clone()) == drive(blind, observation.clone())


def test_new_group_is_static():
    observation = scan(disc(0.7, 0.8), motion=(0.0, -0.2), at=(0.7, 0.8))
    observation[keys.TAGD_VALID][..., 0] = False
    blind, seeing = DynamicWindow(ROBOT), DynamicWindow(ROBOT, True)
    assert drive(seeing, observation.clone()) == drive(blind, observation.clone())


def test_window_is_limited_by_wheel_acceleration():
    slow = DifferentialDrive(model="wheeled", wheel_acceleration=0.5)
    policy, observation = DynamicWindow(slow), scan()
    v, w = drive(policy, observation)  # from rest
    assert (v, abs(w)) == (pytest.approx(0.1), pytest.approx(0.0, abs=0.5))
    v, _ = drive(policy, observation)  # the action before is in the TensorDict
    assert v == pytest.approx(0.2)


def test_window_treats_a_missing_action_as_stationary():
    """NaN marks worlds that were reset while others went on."""
    slow = DifferentialDrive(model="wheeled", wheel_acceleration=0.5)
    one = scan()
    observation = one.expand(3).clone()
    observation[keys.ACTION] = torch.tensor([[torch.nan] * 2, [-1.0, 0.0], [0.0, 0.0]])
    chosen = physical_command(slow, DynamicWindow(slow)(observation)[keys.ACTION])[:, 0]
    torch.testing.assert_close(chosen, torch.tensor([0.1, 0.1, 0.6]))


def test_window_takes_any_batch_shape():
    one = scan(disc(0.9, 0.1))
    policy = DynamicWindow(ROBOT, True)
    alone = policy(one.clone())[keys.ACTION]
    many = policy(one.expand(6).clone().reshape(2, 3))[keys.ACTION]
    torch.testing.assert_close(many, alone.expand(2, 3, 2))
    torch.testing.assert_close(policy(one[0].clone())[keys.ACTION], alone[0])


@pytest.mark.parametrize(
    "name, value",
    [
        ("num_turn_rates", 4),
        ("num_speeds", 1),
        ("margin", -1),
        ("max_descriptor_speed", 0.1),
        ("horizon_steps", 0),
        ("group_radius", 0.0),
    ],
)
def test_window_names_invalid_arguments(name, value):
    with pytest.raises(ValueError, match=f"{name}={value}"):
        DynamicWindow(ROBOT, **{name: value})


# --- stop and go ---------------------------------------------------------------------------------


def test_stop_and_go_drives_on_a_free_arc():
    beside = torch.stack([torch.linspace(-0.5, 1.0, 30), torch.full((30,), 0.21)], dim=-1)
    for things in ([], [beside], [disc(-0.4, 0.0)], [disc(1.0, 0.0)]):
        v, w = drive(StopAndGo(ROBOT), scan(*things))
        assert (v, w) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-5))


@pytest.mark.parametrize("place", [(0.5, 0.0), (0.65, 0.0), (0.4, 0.25)])
def test_stop_and_go_stops_for_obstacles_ahead(place):
    v, w = drive(StopAndGo(ROBOT), scan(disc(*place)))
    assert (v, w) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.0, abs=1e-5))


def test_stop_and_go_checks_the_driven_arc():
    curve = AHEAD @ torch.tensor([[0.8, 0.6], [0.0, 0.0]])  # the pursued point lies to the left
    ahead, on_the_arc = disc(0.5, -0.1, 0.05), disc(0.42, 0.23, 0.05)
    assert drive(StopAndGo(ROBOT), scan(ahead, waypoints=curve))[0] > 0.5
    v, w = drive(StopAndGo(ROBOT), scan(on_the_arc, waypoints=curve))
    assert v == pytest.approx(0.0, abs=1e-6)
    assert w > 0  # waits facing the waypoint


def test_stop_and_go_tolerates_two_sigmas_of_noise():
    """Walls 0.02 m beside the hull, as paths keep off them at least, read 0.05 m too near."""
    walls = [
        torch.stack([torch.linspace(0.0, 1.0, 30), torch.full((30,), side * 0.148)], dim=-1)
        for side in (1, -1)
    ]
    assert drive(StopAndGo(ROBOT), scan(*walls))[0] == pytest.approx(1.0)
    assert drive(StopAndGo(ROBOT, margin=0.0), scan(*walls))[0] == pytest.approx(0.0, abs=1e-6)


def test_beam_without_return_does_not_stop_the_robot():
    observation = scan(disc(0.5, 0.0))
    observation[keys.RETURNS][:] = False
    assert drive(StopAndGo(ROBOT), observation)[0] == pytest.approx(1.0)


def test_stop_and_go_ignores_points_behind():
    behind = torch.tensor([[-0.12, 0.0]])
    assert drive(StopAndGo(ROBOT), scan(behind))[0] == pytest.approx(1.0)


def test_tight_arc_is_checked_for_a_quarter_circle():
    """Half a circle of radius 0.08 m would end beside the point."""
    tight = torch.tensor([0.05, 0.15]).expand(5, 2)
    assert drive(StopAndGo(ROBOT), scan(torch.tensor([[0.02, 0.29]]), waypoints=tight))[0] > 0.1
    assert drive(StopAndGo(ROBOT), scan(torch.tensor([[0.15, 0.15]]), waypoints=tight))[0] == 0.0


def test_turning_in_place_is_never_blocked():
    """The waypoint is behind to the left: full turn rate, whatever is near."""
    back = torch.tensor([-0.3, 0.3]).expand(5, 2)
    v, w = drive(StopAndGo(ROBOT), scan(disc(0.3, 0.0), waypoints=back))
    assert (v, w) == (pytest.approx(0.0, abs=1e-6), pytest.approx(math.pi, rel=1e-5))


def test_stop_and_go_names_invalid_arguments():
    with pytest.raises(ValueError, match=r"margin=-0\.2: must be > -0\.178"):
        StopAndGo(ROBOT, margin=-0.2)
    with pytest.raises(ValueError, match="stop_distance=0"):
        StopAndGo(ROBOT, stop_distance=0)
    with pytest.raises(ValueError, match="min_speed"):
        StopAndGo(DifferentialDrive(min_speed=0.1))


# --- orca ----------------------------------------------------------------------------------------

rvo = pytest.mark.skipif(importlib.util.find_spec("pyrvo") is None, reason="needs the extra orca")


def world(walls=(), speed=0.0, people=1):
    return ScenarioBatch.pack(
        [
            Scenario(
                suite="by hand",
                seed=0,
                index=0,
                kind="corridor",
                boxes=np.array(walls, dtype=float).reshape(-1, 5),
                start=np.zeros(3),
                goal=np.array([5.0, 0.0]),
                path=np.array([[0.0, 0.0], [5.0, 0.0]]),
                pedestrians=(Pedestrian(np.array([[0.0, 0.0], [9.0, 0.0]]), speed, 0.0),) * people,
                noise_seed=0,
            )
        ]
    )


def step_aside(
    person, motion=(0, 0), walls=(), yaw=0.0, robot=ROBOT, last=None, margins=None, others=()
):
    """The command of ORCA in the second step, after the action ``last``."""
    policy = Orca(robot, sidestep=0.01, **(margins or {}))
    policy.prepare(world(walls, speed=math.hypot(*motion) / 0.2, people=1 + len(others)))
    box = torch.tensor([[[*place, 0.15, 0.15, 0.0] for place in (person, *others)]])
    observation = TensorDict(
        {
            keys.POSE: torch.tensor([[0.0, 0.0, yaw]]),
            keys.WAYPOINTS: AHEAD[None],
            keys.PEDESTRIAN_BOXES: box - torch.tensor([*motion, 0.0, 0.0, 0.0]),
        },
        [1],
    )
    observation = policy(observation).exclude(keys.ACTION)
    if last is not None:
        observation[keys.ACTION] = torch.tensor([last])
    observation[keys.PEDESTRIAN_BOXES] = box
    return physical_command(robot, policy(observation)[keys.ACTION])[0].tolist()


@rvo
def test_orca_drives_straight_without_pedestrians():
    for person in ((torch.nan, torch.nan), (0.0, 3.0), (-1.5, 0.0)):
        v, w = step_aside(person)
        assert v == pytest.approx(1.0, abs=1e-3)
        assert w == pytest.approx(0.05, abs=0.01)  # 0.01 rad in 0.2 s


@rvo
def test_orca_has_full_avoidance_responsibility():
    """Somebody comes head on and keeps coming; the new velocity alone makes the two miss."""
    v, w = step_aside((1.5, -0.05), motion=(-0.16, 0.0))
    angle, speed = 0.2 * w, v / math.cos(0.2 * w)
    relative = np.array([speed * math.cos(angle) + 0.8, speed * math.sin(angle)])
    relative /= np.linalg.norm(relative)
    miss = abs(relative[0] * -0.05 - relative[1] * 1.5)
    assert w > 0
    assert miss >= ROBOT.radius + 0.15 * math.sqrt(2) + 0.1 - 0.02


@rvo
def test_orca_starts_from_its_last_command():
    """Two commands of the step before, two solutions: RVO2 linearizes around the velocity."""
    chosen = [step_aside((0.9, 0.1), last=last) for last in (None, [-1.0, 0.0], [1.0, 0.0])]
    assert chosen[0] == chosen[1]  # at rest
    assert chosen[2] != pytest.approx(chosen[1], abs=0.01)


@rvo
@pytest.mark.parametrize("wall_margin", [0.0, 0.03, 0.05])
def test_orca_keeps_its_margin_to_walls(wall_margin):
    """Facing a wall 0.06 m off the hull at a flat angle, it uses what the margin leaves of that."""
    nobody, yaw = (torch.nan, torch.nan), -0.3
    wall = (1.0, -(ROBOT.radius + 0.06 + 0.1), 4.0, 0.1, 0.0)
    v, w = step_aside(nobody, walls=[wall], yaw=yaw, margins={"wall_margin": wall_margin})
    approach = -v / math.cos(0.2 * w) * math.sin(yaw + 0.2 * w)
    assert approach == pytest.approx((0.06 - wall_margin) / 0.4, abs=1e-3)  # wall_horizon 0.4 s


@rvo
def test_wall_margin_does_not_change_distances_to_people():
    for person in ((0.9, 0.1), (0.5, 0.3), (1.2, -0.2)):
        near, far = (step_aside(person, margins={"wall_margin": m}) for m in (0.0, 0.2))
        assert near == pytest.approx(far, abs=1e-4)


@rvo
@pytest.mark.parametrize("max_speed", [0.2, 1.0])
def test_orca_reacts_within_its_time_horizon(max_speed):
    """A pedestrian at 0.6 m/s, head on: contact in 1.9 s is avoided, in 2.1 s not yet."""
    slow = DifferentialDrive(max_speed=max_speed)
    contact = ROBOT.radius + 0.15 * math.sqrt(2) + 0.1
    for time_s, reacts in ((1.9, True), (2.1, False)):
        distance = contact + (max_speed + 0.6) * time_s
        v, w = step_aside((distance, 0.0), motion=(-0.12, 0.0), robot=slow, last=[1.0, 0.0])
        assert (v < 0.99 * max_speed or abs(w) > 0.06) is reacts


@rvo
def test_orca_takes_velocities_from_the_last_step(monkeypatch):
    """A pedestrian at 0.6 m/s is at 0.6 m/s in every step, and at rest in the first."""
    policy, seen = Orca(ROBOT), []
    policy.prepare(world(speed=0.6))
    monkeypatch.setattr(policy, "_solve", lambda *row: seen.append(row[-1][0]) or (0.0, 0.0))
    observation = TensorDict({keys.POSE: torch.zeros(1, 3), keys.WAYPOINTS: AHEAD[None]}, [1])
    for step in range(4):
        box = torch.tensor([[[2.0 - 0.12 * step, 0.5, 0.15, 0.15, 0.0]]])
        policy(observation.set(keys.PEDESTRIAN_BOXES, box))
    speeds = [0.0, -0.6, -0.6, -0.6]
    torch.testing.assert_close(torch.tensor(seen), torch.tensor([[v, 0.0] for v in speeds]))


@rvo
def test_orca_considers_more_than_the_nearest_pedestrian():
    """One stands behind, nearest; the other is head on."""
    alone = step_aside((1.0, -0.05))
    assert step_aside((-0.6, 0.0)) != pytest.approx(alone, abs=0.1)
    assert step_aside((-0.6, 0.0), others=[(1.0, -0.05)]) == pytest.approx(alone, abs=1e-4)


@rvo
def test_orca_turns_instead_of_backing_up():
    reverse = DifferentialDrive(min_speed=-0.25)
    v, w = step_aside((0.55, 0.0), motion=(-0.16, 0.0), robot=reverse)
    assert v >= -1e-6
    assert abs(w) > 1.0


@rvo
def test_orca_avoids_walls():
    v, _ = step_aside((torch.nan, torch.nan), walls=[(0.45, 0.0, 0.1, 2.0, 0.0)])
    assert 0.2 * v < 0.35 - ROBOT.radius
    free, _ = step_aside((torch.nan, torch.nan), walls=[(0.45, 3.0, 0.1, 2.0, 0.0)])
    assert free == pytest.approx(1.0, abs=1e-3)


@rvo
def test_orca_reads_world_frames():
    """Facing up, somebody in the world's x direction is to the right, not ahead."""
    v, w = step_aside((1.0, 0.0), yaw=math.pi / 2)
    assert (v, w) == (pytest.approx(1.0, abs=1e-3), pytest.approx(0.05, abs=0.01))
    v, _ = step_aside((0.0, 0.7), yaw=math.pi / 2)
    assert v < 0.9


@rvo
def test_orca_requires_preparation_and_valid_arguments():
    observation = scan()
    observation[keys.POSE] = torch.zeros(1, 3)
    observation[keys.PEDESTRIAN_BOXES] = torch.zeros(1, 1, 5)
    with pytest.raises(RuntimeError, match="prepare"):
        Orca(ROBOT)(observation)
    wrong = {"iterations": 0, "waypoint": -1, "time_horizon": 0.0, "margin": -1, "wall_margin": -1}
    for name, value in wrong.items():
        with pytest.raises(ValueError, match=f"{name}={value}"):
            Orca(ROBOT, **{name: value})


def test_missing_orca_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrvo", None)
    with pytest.raises(ImportError, match=r"-e '\.\[orca\]"):
        Orca(ROBOT)
