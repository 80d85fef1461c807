"""Episodes whose end is known beforehand, and records that do not depend on their neighbors."""

import math

import numpy as np
import pytest
import torch
from torchrl.envs import Compose
from torchrl.envs.utils import ExplorationType, exploration_type

from navrl import keys
from navrl.envs import NavigationEnv
from navrl.evaluation import ERROR, evaluate
from navrl.factory import make_env
from navrl.sim import BatchedSimulator, DifferentialDrive, Lidar
from navrl.worlds import Pedestrian, Scenario, ScenarioBatch

RADIUS = 0.178
LIMIT = 25


def person(*route, speed=0.0):
    return Pedestrian(np.array(route, dtype=float), speed, 0.0)


def episode(index, *, goal=(9.0, 0.0), walls=(), people=(), start=(0.0, 0.0, 0.0)):
    return Scenario(
        suite="by hand",
        seed=0,
        index=index,
        kind="corridor",
        boxes=np.array(walls, dtype=float).reshape(-1, 5),
        start=np.array(start, dtype=float),
        goal=np.array(goal, dtype=float),
        path=np.array([start[:2], goal], dtype=float),
        pedestrians=tuple(people),
        noise_seed=0,
    )


WALL = (2.0, 0.0, 0.1, 1.0, 0.0)
EPISODES = [  # the robot drives straight ahead at 1 m/s
    episode(0, goal=(1.1, 0.0)),  # within 0.2 m after 1.0 m
    episode(1, walls=[WALL]),
    episode(2, people=[person((1.5, 0.0))]),
    episode(3, people=[person((1.0, 0.6))]),  # drives past
    episode(4, people=[person((-3.0, 0.0), (6.0, 0.0), speed=3.0)]),  # runs up from behind
    episode(5, goal=(0.5, 0.3)),  # passed at 0.3 m, never reached
    episode(6, goal=(2.1, 0.0), people=[person((0.0, 5.0))]),
]
OUTCOMES = [
    "success",
    "collision_static",
    "collision_pedestrian",
    "timeout",
    "collision_pedestrian",
    "timeout",
    "success",
]


def make(num_worlds):
    simulator = BatchedSimulator(num_worlds, robot=DifferentialDrive(), lidar=Lidar(num_beams=72))
    env = NavigationEnv(simulator, None, {}, time_limit_steps=LIMIT, privileged=True)
    return make_env(env, Compose())


@pytest.fixture(scope="module")
def envs():
    return {count: make(count) for count in (1, 3, len(EPISODES))}


def straight(tensordict):
    action = torch.zeros(*tensordict.batch_size, 2)
    action[..., 0] = 1.0
    return tensordict.set(keys.ACTION, action)


def wobbling(tensordict):
    """Something whose action depends on what each world shows."""
    tensordict = straight(tensordict)
    tensordict[keys.ACTION][..., 1] = torch.sin(37.0 * tensordict[keys.RANGES].sum(-1)) / 2
    return tensordict


@pytest.fixture(scope="module")
def batch():
    return ScenarioBatch.pack(EPISODES)


@pytest.fixture(scope="module")
def records(envs, batch):
    return evaluate(envs[len(EPISODES)], straight, batch)


def test_outcome_matches_the_scene(records):
    assert [record.outcome for record in records] == OUTCOMES
    assert [record.index for record in records] == list(range(len(EPISODES)))
    assert {record.scenario for record in records} == {"corridor"}
    assert {record.error for record in records} == {""}


def test_steps_times_and_lengths_match_the_trajectory(records):
    success, wall, *_, timeout, _ = records
    assert (success.steps, success.time_s) == (5, pytest.approx(1.0))
    assert success.path_length_m == pytest.approx(1.0, abs=1e-5)
    assert wall.steps == math.ceil((1.9 - RADIUS) / 0.2)
    assert wall.path_length_m == pytest.approx(1.9 - RADIUS, abs=0.021)  # a substep is 0.02 m
    assert (timeout.steps, timeout.time_s) == (LIMIT, pytest.approx(5.0))
    assert timeout.path_length_m == pytest.approx(5.0, abs=1e-4)


def test_distances_are_between_surfaces(records):
    assert records[0].min_pedestrian_distance_m == math.inf
    assert records[2].min_pedestrian_distance_m == 0.0
    assert records[3].min_pedestrian_distance_m == pytest.approx(0.6 - 0.15 - RADIUS, abs=1e-5)


def test_the_distance_at_the_start_counts(envs):
    """Somebody abreast at the start is left behind at once."""
    scene = ScenarioBatch.pack([episode(0, people=[person((-0.1, 0.5))])])
    (record,) = evaluate(envs[1], straight, scene)
    assert record.min_pedestrian_distance_m == pytest.approx(0.5 - 0.15 - RADIUS, abs=1e-5)


def test_at_fault_party_is_recorded(records):
    assert [record.hit_by_pedestrian for record in records] == [
        i == 4 for i in range(len(EPISODES))
    ]


@pytest.mark.parametrize("policy", [straight, wobbling])
@pytest.mark.parametrize("num_worlds", [1, 3])
def test_records_do_not_depend_on_the_batch(envs, batch, policy, num_worlds):
    """Neither on who is played beside, nor on worlds that go on, nor on the padding."""
    expected = evaluate(envs[len(EPISODES)], policy, batch)
    assert evaluate(envs[num_worlds], policy, batch) == expected


def test_repeated_rollout_is_identical(envs, batch):
    first, second = (evaluate(envs[3], wobbling, batch) for _ in range(2))
    assert first == second


def test_policy_runs_without_noise_or_gradient(envs, batch):
    seen = set()

    def policy(tensordict):
        seen.add((exploration_type(), torch.is_grad_enabled()))
        return straight(tensordict)

    evaluate(envs[3], policy, batch)
    assert seen == {(ExplorationType.DETERMINISTIC, False)}


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_policy_reads_its_own_last_action(envs, batch, num_worlds):
    """Absent in the first step of an episode, the action of the step before after that."""
    seen, written = [], []

    def policy(tensordict):
        seen.append(tensordict.get(keys.ACTION, None))
        decided = wobbling(tensordict.exclude(keys.ACTION))
        written.append(decided[keys.ACTION].clone())
        return decided

    evaluate(envs[num_worlds], policy, batch[torch.arange(num_worlds)])
    assert seen[0] is None
    assert len(seen) >= 5
    assert all(torch.equal(*pair) for pair in zip(seen[1:], written[:-1], strict=True))


def test_progress_counts_each_episode_once(envs, batch):
    done = []
    evaluate(envs[3], straight, batch, on_chunk=done.append)
    assert done == [3, 3, 1]


@pytest.mark.parametrize("num_worlds", [1, 3, len(EPISODES)])
def test_failed_episode_does_not_affect_others(envs, batch, records, num_worlds):
    def policy(tensordict):
        if bool((tensordict[keys.PATH][:, -1] == torch.tensor([0.5, 0.3])).all(-1).any()):
            raise ZeroDivisionError("no way")
        return straight(tensordict)

    found = evaluate(envs[num_worlds], policy, batch)
    assert found[5].outcome == ERROR
    assert "ZeroDivisionError: no way" in found[5].error
    assert math.isnan(found[5].time_s)
    assert found[:5] + found[6:] == records[:5] + records[6:]


def test_a_policy_that_always_raises_is_all_errors(envs, batch):
    def policy(_):
        raise RuntimeError("broken")

    found = evaluate(envs[3], policy, batch)
    assert [(record.index, record.outcome) for record in found] == [(i, ERROR) for i in range(7)]


class Seer:
    """Notes what it is shown before each reset; knows how to win every other episode."""

    def __init__(self, plans=True):
        self.shown, self.plans = [], plans

    def prepare(self, scenarios):
        self.shown.append(scenarios.goal.tolist())
        return scenarios.goal[:, 1] == 0.0 if self.plans else None

    def __call__(self, tensordict):
        return straight(tensordict)


def test_preparing_policy_receives_its_scenarios(envs, batch):
    seer = Seer()
    found = evaluate(envs[3], seer, batch)
    goals = [scene.goal.tolist() for scene in EPISODES]
    assert seer.shown == [goals[:3], goals[3:6], [goals[6]] * 3]  # the last chunk is padded
    assert [record.solved for record in found] == [goal[1] == 0.0 for goal in goals]


def test_solved_is_none_without_a_planner(envs, batch, records):
    assert {record.solved for record in records} == {None}
    assert evaluate(envs[3], Seer(plans=False), batch) == records


@pytest.mark.parametrize("num_worlds", [1, 3])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_non_finite_action_is_an_error_of_its_episode(envs, batch, records, num_worlds, value):
    """Of its own episode alone, which ends there."""

    def policy(tensordict):
        tensordict = straight(tensordict)
        action, goal = tensordict[keys.ACTION], tensordict[keys.PATH][:, -1]
        is_one = (goal == torch.tensor([0.5, 0.3])).all(-1) & (tensordict[keys.POSE][:, 0] > 1.0)
        action[is_one, 1] = value
        return tensordict

    found = evaluate(envs[num_worlds], policy, batch)
    assert found[5].outcome == ERROR
    assert f"action=[1.0, {value}]: must be finite" in found[5].error
    assert found[:5] + found[6:] == records[:5] + records[6:]


@pytest.mark.parametrize("raises", [False, True])
def test_evaluation_restores_the_callers_scenarios(batch, raises):
    env = make(1)
    own = ScenarioBatch.pack([episode(9, goal=(3.0, 1.0))])
    env.base_env.set_scenarios(own)

    def policy(tensordict):
        if raises:
            raise RuntimeError("broken")
        return straight(tensordict)

    evaluate(env, policy, batch)
    assert env.reset()[keys.PATH][0, -1].tolist() == [3.0, 1.0]
