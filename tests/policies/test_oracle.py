"""The oracle on scenes whose answer is plain, and its word against the simulator's."""

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose

from navrl.envs import NavigationEnv
from navrl.evaluation import evaluate
from navrl.factory import make_env
from navrl.policies.classical import Oracle, SearchEffort
from navrl.policies.classical.maneuvers import maneuvers
from navrl.sim import BatchedSimulator, Delays, DifferentialDrive, Lidar, LimitedDrive
from navrl.worlds import Pedestrian, Scenario, ScenarioBatch

LIMIT = 40
ROOM = [
    (1.0, 1.6, 3.0, 0.1, 0.0),
    (1.0, -1.6, 3.0, 0.1, 0.0),
    (-2.0, 0.0, 0.1, 1.6, 0.0),
    (4.0, 0.0, 0.1, 1.6, 0.0),
]
SEALED = [(1.5, 0.0, 0.1, 1.6, 0.0)]
DOOR = [(1.5, 1.0, 0.1, 0.7, 0.0), (1.5, -1.0, 0.1, 0.7, 0.0)]  # 0.6 m wide, at y = 0
QUICK = [SearchEffort(0.01, 1.2, 200_000)]


def walker(*route, speed, offset=0.0):
    return Pedestrian(np.array(route, dtype=float), speed, offset)


def scene(walls=(), people=(), goal=(3.1, 0.0), yaw=0.0):
    return Scenario(
        suite="by hand",
        seed=0,
        index=0,
        kind="office",
        boxes=np.array([*ROOM, *walls], dtype=float),
        start=np.array([0.0, 0.0, yaw]),
        goal=np.array(goal),
        path=np.array([(0.0, 0.0), goal]),
        pedestrians=tuple(people),
        noise_seed=0,
    )


def oracle(**changes):
    defaults = {"robot": DifferentialDrive(), "time_limit_steps": LIMIT, "efforts": QUICK}
    return Oracle(**{**defaults, **changes})


def play(*scenes, policy=None, robot=None, delays=None, limit=LIMIT):
    robot, delays = robot or DifferentialDrive(), delays or Delays()
    simulator = BatchedSimulator(len(scenes), robot=robot, lidar=Lidar(num_beams=8), delays=delays)
    env = NavigationEnv(simulator, None, {}, time_limit_steps=limit, privileged=True)
    policy = policy or oracle(robot=robot, delays=delays, time_limit_steps=limit)
    return evaluate(make_env(env, Compose()), policy, ScenarioBatch.pack(scenes))


SCENES = {
    "empty": scene(),
    "the goal lies behind": scene(yaw=math.pi),
    "any yaw": scene(yaw=0.3),
    "a door": scene(walls=DOOR),
    "somebody stands in the way": scene(people=[walker((1.5, 0.0), speed=0.0)]),
    "somebody comes": scene(people=[walker((3.0, 0.0), (-1.0, 0.0), speed=0.8)]),
    "somebody stays in the door for a while": scene(
        walls=DOOR, people=[walker((1.5, 0.0), (3.5, 1.2), speed=0.3, offset=4.5)]
    ),
    "somebody fast crosses": scene(people=[walker((1.0, 1.2), (1.0, -1.2), speed=2.0)]),
}


def test_solved_episodes_succeed():
    """The search's arcs and contacts are the simulator's, or it would not get through."""
    records = play(*SCENES.values())
    assert {n: r.outcome for n, r in zip(SCENES, records, strict=True)} == dict.fromkeys(
        SCENES, "success"
    )
    assert all(record.solved for record in records)


def test_planned_path_is_short():
    empty, behind, *_ = play(*SCENES.values())
    assert empty.steps == math.ceil((3.1 - 0.2) / 0.2)
    assert behind.steps <= empty.steps + math.ceil(math.pi / (math.pi * 0.2))  # turn, then go


def test_unsolvable_episode_is_reported():
    blocked = scene(people=[walker((1.5, 0.0), speed=0.0)], walls=DOOR)
    doomed = scene(people=[walker((0.0, 0.34), (0.0, -1.0), speed=3.0)])
    records = play(scene(walls=SEALED), blocked, doomed, scene())
    assert [record.solved for record in records] == [False, False, False, True]
    assert records[0].outcome == "timeout"
    assert records[0].path_length_m == 0.0


def test_failed_search_is_repeated_with_more_effort():
    hopeless = SearchEffort(0.01, 1.0, 5)
    assert not play(scene(), policy=oracle(efforts=[hopeless]))[0].solved
    assert play(scene(), policy=oracle(efforts=[hopeless, *QUICK]))[0].solved


def test_plan_respects_the_margin():
    wide, narrow = SearchEffort(0.14, 1.2, 200_000), SearchEffort(0.1, 1.2, 200_000)
    door = scene(walls=DOOR)  # leaves 0.122 m to either side
    assert not play(door, policy=oracle(efforts=[wide]))[0].solved
    assert play(door, policy=oracle(efforts=[narrow]))[0].solved


def test_the_step_limit_is_part_of_the_plan():
    need = math.ceil((3.1 - 0.2) / 0.2)
    batch = ScenarioBatch.pack([scene()])
    assert bool(oracle(time_limit_steps=need).prepare(batch))
    assert not bool(oracle(time_limit_steps=need - 1).prepare(batch))


@pytest.mark.parametrize("robot", [DifferentialDrive(max_speed=0.22), LimitedDrive(speed_cap=0.22)])
def test_goal_that_is_just_in_time_for_a_slow_robot_is_found(robot):
    """Its path on the grid of cells is the longest compared with the straight one."""
    yaw = math.pi / 8
    goal = (3.1 * math.cos(yaw), 3.1 * math.sin(yaw))
    need = math.ceil((3.1 - 0.2) / (0.22 * 0.2)) + 5  # poses that share a cell cost a few
    policy = oracle(robot=robot, time_limit_steps=need)
    assert bool(policy.prepare(ScenarioBatch.pack([scene(yaw=yaw, goal=goal)])))


def test_equal_scenarios_share_a_plan_in_any_batch():
    scenes = [SCENES["somebody comes"], SCENES["a door"], SCENES["somebody comes"]]
    batch, policy = ScenarioBatch.pack(scenes), oracle()
    policy.prepare(batch)
    together = policy(TensorDict({}, [3]))["action"]
    policy.prepare(batch[torch.tensor([1])])
    alone = policy(TensorDict({}, [1]))["action"]
    assert torch.equal(together[0], together[2])
    assert torch.equal(together[1], alone[0])


SLOW_BASES = {
    "wheels": DifferentialDrive(model="wheeled", wheel_acceleration=1.0),
    "accelerations": LimitedDrive(
        max_speed=0.7,
        linear_acceleration=0.5,
        linear_deceleration=0.6,
        angular_acceleration=3.5,
        angular_deceleration=4.2,
    ),
    "lag": LimitedDrive(linear_lag_s=0.2, angular_lag_s=0.2),
    "scale and cap": LimitedDrive(linear_scale=0.9, angular_scale=1.1, speed_cap=0.5),
}


@pytest.mark.parametrize("base", SLOW_BASES)
def test_maneuvers_end_at_velocities_of_the_grid(base):
    robot = SLOW_BASES[base]
    table = maneuvers(robot, 0.2, 10)
    start, action = (table.following >= 0).nonzero().unbind(-1)
    commands = table.commands[start, action]
    low, high = (torch.tensor(limit) for limit in robot.command_limits)
    assert bool(((commands >= low) & (commands <= high)).all())
    poses, velocities = robot.rollout(
        torch.zeros(len(start), 3, dtype=torch.float64),
        table.velocities[start],
        commands.expand(10, -1, -1),
        0.02,
    )
    wanted = table.velocities[table.following[start, action]]
    torch.testing.assert_close(velocities[-1], wanted, atol=1e-7, rtol=0.0)
    torch.testing.assert_close(poses.transpose(0, 1), table.offsets[start, action])
    seen, queue = {table.rest}, [table.rest]
    while queue:
        for index in table.following[queue.pop()].tolist():
            if index >= 0 and index not in seen:
                seen.add(index)
                queue.append(index)
    assert len(seen) == len(table.velocities)  # each velocity can be reached from rest


@pytest.mark.parametrize("delay_s", [0.0, 0.1])
@pytest.mark.parametrize("base", SLOW_BASES)
def test_plans_of_slow_bases_succeed(base, delay_s):
    names = ("empty", "any yaw", "a door", "somebody stands in the way")
    delays = Delays(command_delay_s=delay_s)
    records = play(
        *(SCENES[name] for name in names), robot=SLOW_BASES[base], delays=delays, limit=60
    )
    assert [(r.solved, r.outcome) for r in records] == [(True, "success")] * len(names)


@pytest.mark.parametrize(
    "delays",
    [
        Delays(command_delay_s=0.3),
        Delays(turn_rate_delay_s=0.2),
        Delays(speed_delay_s=0.2, command_delay_s=0.04),
    ],
)
def test_plans_account_for_late_commands(delays):
    people = ("somebody comes", "somebody fast crosses", "the goal lies behind")
    records = play(*(SCENES[name] for name in people), delays=delays)
    assert [(r.solved, r.outcome) for r in records] == [(True, "success")] * len(people)


def test_delay_counts_towards_the_step_limit():
    need = math.ceil((3.1 - 0.2) / 0.2)
    batch, late = ScenarioBatch.pack([scene()]), Delays(command_delay_s=0.2)
    assert bool(oracle(time_limit_steps=need + 1, delays=late).prepare(batch))
    assert not bool(oracle(time_limit_steps=need, delays=late).prepare(batch))


def test_unprepared_worlds_are_rejected():
    with pytest.raises(RuntimeError, match="prepare"):
        oracle()(TensorDict({}, [2]))


@pytest.mark.parametrize(
    "changes, named",
    [
        ({"robot": DifferentialDrive(min_speed=0.1)}, "robot.min_speed=0.1"),
        ({"speeds": [1.0]}, "speeds"),
        ({"speeds": [2.0, 0.0]}, "speeds"),
        ({"turns": []}, "turns"),
        ({"turns": [0.4, 0.9]}, "turns"),
        ({"efforts": []}, "efforts"),
        ({"cell": 0.0}, "cell"),
        ({"goal_radius": -1.0}, "goal_radius"),
    ],
)
def test_bad_settings_are_named(changes, named):
    with pytest.raises(ValueError, match=named):
        Oracle(**{"robot": DifferentialDrive(), **changes})
    with pytest.raises(ValueError, match="margin=-1"):
        SearchEffort(-1, 1, 1)
