"""Episodes made by hand: limits, rewards and state of the environment, value by value."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from navrl.envs import Collision, Goal, NavigationEnv, Outcome, Progress, Proximity
from navrl.sim import BatchedSimulator, Contact, DifferentialDrive, Lidar
from navrl.worlds import Pedestrian, Scenario, ScenarioBatch

WALL = (2.0, 0.0, 0.1, 1.0, 0.0)  # its face is at x = 1.9 m
PERSON = Pedestrian(np.array([[1.0, 0.0]]), 0.0, 0.0)  # its face is at x = 0.85 m
TERMS = {
    "collision": Collision(10.0),
    "goal": Goal(10.0),
    "progress": Progress(2.0),
    "potential": Progress(1.0, "potential", gamma=0.5),
    "proximity": Proximity(3.0, 0.5),
    "absent": None,
}


def scenario(goal=9.0, start=0.0, walls=(), people=(), noise_seed=0):
    return Scenario(
        suite="by hand",
        seed=0,
        index=0,
        kind="corridor",
        boxes=np.array(walls, dtype=float).reshape(-1, 5),
        start=np.array([start, 0.0, 0.0]),
        goal=np.array([goal, 0.0]),
        path=np.array([[start, 0.0], [goal, 0.0]]),
        pedestrians=tuple(people),
        noise_seed=noise_seed,
    )


def make(*scenarios, **options):
    simulator = BatchedSimulator(len(scenarios), DifferentialDrive(), Lidar(num_beams=72))
    env = NavigationEnv(simulator, None, TERMS, seed=0, **options)
    env.set_scenarios(ScenarioBatch.pack(scenarios))
    return env


def drive(env, td, speeds, steps=1):
    for _ in range(steps):
        action = torch.tensor([[speed, 0.0] for speed in speeds])
        td = env.step(td.set("action", action))["next"]
    return td


def reset_first(env, td):
    mask = torch.zeros(env.batch_size[0], 1, dtype=torch.bool)
    mask[0] = True
    return env.reset(td.clone().set("_reset", mask))


@pytest.mark.parametrize("options", [{"goal_radius": 0.0}, {"time_limit_steps": 0}])
def test_limits_must_be_positive(options):
    with pytest.raises(ValueError, match=r"goal_radius=.*, time_limit_steps=.*: must be > 0"):
        make(scenario(), **options)


def test_terms_set_to_none_are_omitted():
    env = make(scenario())
    assert set(env.reset()["reward_terms"].keys()) == TERMS.keys() - {"absent"}


def test_action_bounds_equal_the_robots_limits():
    spec = make(scenario(), scenario()).action_spec.space
    robot = DifferentialDrive()
    assert spec.low[1].tolist() == pytest.approx([robot.min_speed, -robot.max_turn_rate])
    assert spec.high[1].tolist() == pytest.approx([robot.max_speed, robot.max_turn_rate])


def test_goal_terminates_and_pays():
    env = make(scenario(goal=0.5))
    td = drive(env, env.reset(), [1.0])
    assert td["reward_terms", "goal"].item() == 0.0
    td = drive(env, td, [1.0])  # at 0.4 m, within 0.2 m of the goal
    assert td["outcome"].item() == Outcome.SUCCESS
    assert td["reward_terms", "goal"].item() == 10.0
    assert td["terminated"].item() and not td["truncated"].item()


def test_collision_with_a_pedestrian_costs_and_terminates():
    env = make(scenario(people=[PERSON]))
    td = drive(env, env.reset(), [1.0], steps=4)  # 0.672 m to drive
    assert td["outcome"].item() == Outcome.COLLISION_PEDESTRIAN
    assert td["contact"].item() == Contact.PEDESTRIAN
    assert td["reward_terms", "collision"].item() == -10.0
    assert td["terminated"].item() and not td["truncated"].item()


def test_proximity_is_of_the_nearest_noise_free_return():
    env = make(scenario(walls=[WALL]))
    td = drive(env, env.reset(), [1.0], steps=8)  # 0.3 m from the wall's face
    assert td["reward_terms", "proximity"].item() == pytest.approx(-3.0 * 0.2, abs=1e-4)


def test_clearance_is_never_negative():
    env = make(scenario(people=[PERSON]), privileged=True)
    td = drive(env, env.reset(), [1.0], steps=5)
    assert td["pedestrian_clearance"].item() == 0.0


def test_progress_restarts_after_a_partial_reset():
    env = make(scenario(), scenario())
    td = drive(env, env.reset(), [1.0, 1.0], steps=5)
    td = drive(env, reset_first(env, td), [1.0, 0.5])
    assert td["reward_terms", "progress"].flatten().tolist() == pytest.approx([0.4, 0.2], abs=1e-5)


def test_time_limit_counts_from_a_partial_reset():
    env = make(scenario(), scenario(), time_limit_steps=3)
    td = drive(env, env.reset(), [0.1, 0.1], steps=2)
    td = drive(env, reset_first(env, td), [0.1, 0.1])
    assert td["truncated"].flatten().tolist() == [False, True]
    td = drive(env, td, [0.1, 0.1], steps=2)
    assert td["truncated"].flatten().tolist() == [True, True]


def test_partial_reset_replaces_goal_path_and_noise():
    env = make(scenario(), scenario())
    td = drive(env, env.reset(), [1.0, 1.0])
    again = scenario(start=2.0, goal=2.5, walls=[(2.0, 1.0, 2.0, 0.1, 0.0)], noise_seed=7)
    env.set_scenarios(ScenarioBatch.pack([again, again]))
    td = reset_first(env, td)
    assert td["path"][0, -1].tolist() == [2.5, 0.0]
    assert td["path"][1, -1].tolist() == [9.0, 0.0]
    td = drive(env, td, [1.0, 1.0])
    # gamma (progress - length) - (progress before - length), paths of 0.5 and 9 m
    expected = [0.5 * (0.2 - 0.5) + 0.5, 0.5 * (0.4 - 9.0) - (0.2 - 9.0)]
    assert td["reward_terms", "potential"].flatten().tolist() == pytest.approx(expected, abs=1e-5)
    td = drive(env, td, [1.0, 1.0])
    assert td["outcome"].flatten().tolist() == [Outcome.SUCCESS, Outcome.RUNNING]


def test_noise_depends_on_its_seed():
    room = [(0.0, 1.0, 5.0, 0.1, 0.0), (0.0, -1.0, 5.0, 0.1, 0.0)]
    seeds = (1, 1, 2)
    env = make(*(scenario(walls=room, noise_seed=seed) for seed in seeds))
    for td in (env.reset(), drive(env, env.reset(), [0.5] * 3)):
        first, same, other = td["ranges"]
        assert torch.equal(first, same)
        assert not torch.equal(first, other)


def test_restored_state_draws_the_same_episodes():
    def fresh(seed):
        simulator = BatchedSimulator(1, DifferentialDrive(), Lidar(num_beams=72))
        pool = SimpleNamespace(to=lambda device: pool, draw=draw)
        return NavigationEnv(simulator, pool, TERMS, seed=seed)

    def draw(generator, count, max_dynamic):
        start = float(torch.rand((), generator=generator))
        return ScenarioBatch.pack([scenario(start=start)] * count)

    env, other = fresh(0), fresh(1)
    env.reset()
    other.reset()
    other.load_episode_state(env.episode_state())
    assert torch.equal(env.reset()["pose"], other.reset()["pose"])


def test_reset_without_scenarios_names_the_missing_argument():
    simulator = BatchedSimulator(1, DifferentialDrive(), Lidar(num_beams=72))
    with pytest.raises(ValueError, match=r"scenarios=None: call set_scenarios\(\)"):
        NavigationEnv(simulator, None, TERMS).reset()


def test_reset_names_unknown_keywords():
    with pytest.raises(ValueError, match=r"reset\(options=\{'index': 3\}\): must be a TensorDict"):
        make(scenario()).reset(options={"index": 3})


def test_close_closes_the_simulator_once(monkeypatch):
    env = make(scenario())
    calls = []
    monkeypatch.setattr(env.simulator, "close", lambda: calls.append("simulator"))
    env.close()
    env.close()
    assert calls == ["simulator"]


def test_progress_does_not_jump_to_a_near_branch_of_the_path():
    hairpin = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 0.3], [0.0, 0.3]])
    north = np.array([0.0, 0.0, np.pi / 2])
    env = make(dataclasses.replace(scenario(), path=hairpin, start=north))
    td = drive(env, env.reset(), [1.0])  # at (0, 0.2), 0.1 m from the last branch
    assert td["reward_terms", "progress"].item() == pytest.approx(0.0, abs=1e-5)


def test_partial_reset_uses_the_worlds_own_scenario():
    env = make(scenario(), scenario(goal=5.0))
    td = env.reset()
    mask = torch.tensor([[False], [True]])
    td = env.reset(td.clone().set("_reset", mask))
    assert td["path"][:, -1].tolist() == [[9.0, 0.0], [5.0, 0.0]]
