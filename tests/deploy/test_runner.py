"""A robot's commands are those of the same policy in a simulated episode."""

import numpy as np
import pytest
import torch

from navrl import build
from navrl.build.training import deployed
from navrl.config import compose, instantiate
from navrl.deploy import PolicyRunner
from navrl.envs.navigation import NavigationEnv
from navrl.evaluation.recording import record_episode
from navrl.policies import ZOO, load_bundle
from navrl.policies.classical import DynamicWindow
from navrl.sim import BatchedSimulator

EXPERIMENTS = ["paper", "no_tagd", "subgoal", "liang", "liang_original", "navrl-best"]
AHEAD = [(0.0, 0.0), (2.0, 0.5)]


@pytest.fixture(scope="module")
def runner():
    return PolicyRunner.from_bundle(ZOO / "paper")


def clear(beams=1440):
    return np.full(beams, 3.5)


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_commands_are_those_of_the_simulated_episode(experiment):
    torch.manual_seed(0)
    cfg = deployed(compose("train", [f"experiment={experiment}", "suite=smoke"]))
    robot, lidar = instantiate(cfg.robot), instantiate(cfg.lidar)
    env = build.make_env(
        NavigationEnv(BatchedSimulator(1, robot, lidar), None, rewards={}, privileged=True),
        instantiate(cfg.transforms),
    )
    actor, _ = build.make_agent(cfg, build.observation_shapes(env))
    scenario = instantiate(cfg.suite).scenarios([1])[0]
    episode = record_episode(env, actor.eval(), scenario)
    runner = PolicyRunner(instantiate(cfg.transforms), actor, lidar, robot)
    assert episode.num_steps > 3
    for _ in range(2):  # and again after a reset
        commands = [
            runner.act(episode.ranges[step], episode.pose[step], episode.path)
            for step in range(episode.num_steps)
        ]
        np.testing.assert_allclose(commands, episode.action, atol=1e-5)
        runner.reset()
    assert np.ptp(episode.action, axis=0).max() > 1e-3


def test_a_controller_reads_its_last_action():
    """A dynamic window on slow wheels reaches full speed, and starts at rest after a reset."""
    cfg = compose("evaluate", ["policy=dwa", "robot=kobuki_wheeled"])
    robot = instantiate(cfg.robot)
    runner = PolicyRunner(
        instantiate(cfg.transforms), DynamicWindow(robot), instantiate(cfg.lidar), robot
    )
    scan = clear()
    scan[0] = 3.4  # a free circle is not a blind one
    for _ in range(2):
        speeds = [runner.act(scan, (0, 0, 0), AHEAD)[0] for _ in range(4)]
        assert speeds == pytest.approx([0.4, 0.8, 1.0, 1.0], abs=1e-3)
        runner.reset()


def test_the_past_counts_and_is_forgotten(runner):
    near, farther = clear(), clear()
    near[:60], farther[:60] = 1.0, 1.1
    runner.reset()
    first = runner.act(near, (0, 0, 0), AHEAD)
    runner.act(farther, (0, 0, 0), AHEAD)
    later = runner.act(near, (0, 0, 0), AHEAD)
    runner.reset()
    assert np.array_equal(runner.act(near, (0, 0, 0), AHEAD), first)
    assert not np.array_equal(later, first)


@pytest.mark.parametrize("miss", [np.nan, np.inf, 0.0, 25.0])
def test_a_beam_without_return_may_read_anything(runner, miss):
    commands = []
    for value in (3.5, miss):
        ranges = clear()
        ranges[100:200], ranges[300:500] = 0.8, value
        runner.reset()
        commands.append(runner.act(ranges, (0, 0, 0), AHEAD))
    assert np.array_equal(*commands)


@pytest.mark.parametrize(
    ("ranges", "pose", "path", "message"),
    [
        (clear(720), (0, 0, 0), AHEAD, r"ranges: need shape \[1440\], got \[720\]"),
        (np.full(1440, np.nan), (0, 0, 0), AHEAD, "every beam is NaN"),
        (clear(), (0, 0), AHEAD, "pose: need 3 finite numbers"),
        (clear(), (0, np.nan, 0), AHEAD, "pose: need 3 finite numbers"),
        (clear(), (0, 0, 0), [(0, 0, 0)], r"path: need shape \[P, 2\]"),
        (clear(), (0, 0, 0), np.zeros((201, 2)), "P from 1 to 200"),
        (clear(), (0, 0, 0), [(0, 0), (np.inf, 0)], "path: a point is not finite"),
    ],
)
def test_what_cannot_be_sensed_is_refused_and_not_remembered(runner, ranges, pose, path, message):
    runner.reset()
    expected = runner.act(clear(), (0, 0, 0), AHEAD)
    runner.reset()
    with pytest.raises(ValueError, match=message):
        runner.act(ranges, pose, path)
    assert np.array_equal(runner.act(clear(), (0, 0, 0), AHEAD), expected)


def test_transforms_of_another_lidar_are_refused():
    bundle = load_bundle(ZOO / "paper")
    lidar = bundle.build("lidar", num_beams=1441)
    with pytest.raises(ValueError, match="1441"):
        PolicyRunner(bundle.build("transforms"), bundle.actor, lidar, bundle.build("robot"))
