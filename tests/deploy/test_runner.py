"""A robot's commands are those of the same policy in a simulated episode."""

import numpy as np
import pytest
import torch
from nightly import mostly
from tensordict.nn import TensorDictModule
from torchrl.data import Unbounded
from torchrl.envs import Compose, TensorDictPrimer, Transform

from navrl import factory, jobs, keys
from navrl.config import compose, instantiate
from navrl.deploy import DriveState, PolicyRunner, SafetyLimits
from navrl.envs.navigation import NavigationEnv
from navrl.evaluation.recorder import record_episode
from navrl.factory.training import deployed
from navrl.policies import ZOO, load_bundle
from navrl.policies.classical import DynamicWindow
from navrl.sim import BatchedSimulator, DifferentialDrive, Lidar
from navrl.transforms import MinPool, ReturningWaypoints, StallTimer, Waypoints
from navrl.transforms import compose as compose_steps

EXPERIMENTS = ["paper", "no_tagd", "subgoal", "liang", "liang_original", "navrl-best"]
AHEAD = [(0.0, 0.0), (2.0, 0.5)]


@pytest.fixture(scope="module")
def runner():
    return PolicyRunner.from_bundle(ZOO / "paper")


def clear(beams=1440):
    """A scan without returns but for a wall behind, which shows that the lidar works."""
    ranges = np.full(beams, 3.5)
    ranges[beams // 2 - 100 : beams // 2 + 100] = 3.0
    return ranges


@pytest.mark.parametrize("experiment", mostly(EXPERIMENTS, ["paper", "navrl-best"]))
def test_commands_equal_those_of_the_simulated_episode(experiment):
    torch.manual_seed(0)
    cfg = deployed(compose("train", [f"experiment={experiment}", "suite=smoke"]))
    robot, lidar = instantiate(cfg.robot), instantiate(cfg.lidar)
    env = factory.make_env(
        NavigationEnv(BatchedSimulator(1, robot, lidar), None, rewards={}, privileged=True),
        instantiate(cfg.transforms),
    )
    actor, _ = factory.make_agent(cfg, factory.observation_shapes(env))
    scenario = instantiate(cfg.suite).scenarios([1])[0]
    episode = record_episode(env, actor.eval(), scenario)
    simulated = SafetyLimits.simulated()  # an untrained policy leaves its path
    runner = PolicyRunner(instantiate(cfg.transforms), actor, lidar, robot, simulated)
    assert episode.num_steps > 3
    for _ in range(2):  # and again after a reset
        commands = [
            runner.act(episode.ranges[step], episode.pose[step], episode.path)
            for step in range(episode.num_steps)
        ]
        np.testing.assert_allclose(commands, episode.action, atol=1e-5)
        runner.reset()
    assert np.ptp(episode.action, axis=0).max() > 1e-3


@pytest.mark.parametrize("policy", ["paper", "liang_original", "navrl-best"])
def test_commands_are_equal_far_from_the_map_origin(policy):
    runner = PolicyRunner.from_bundle(ZOO / policy)
    shift = np.array([5e5, 5.6e6, 0.0])  # m, as UTM coordinates are
    path = np.stack([np.linspace(0.0, 4.0, 41), np.sin(np.linspace(0.0, 4.0, 41))], axis=-1)
    scan = 2.0 + np.sin(np.linspace(0.0, 20.0, runner.num_beams))
    commands = []
    for offset in (0.0 * shift, shift):
        runner.reset()
        poses = [np.array([0.13 * k, 0.11 * k, 0.3 * k]) for k in range(6)]
        commands.append([runner.act(scan, pose + offset, path + offset[:2]) for pose in poses])
    np.testing.assert_allclose(commands[1], commands[0], atol=1e-5)


@pytest.mark.parametrize("policy", ["paper", "navrl-best"])
def test_trained_policy_drives_an_episode_in_one_state(policy):
    changes = [f"policy={policy}", "suite=table1", "episode=3"]
    episode = jobs.record(compose("play", changes))
    runner = PolicyRunner.from_bundle(ZOO / policy)
    for step in range(episode.num_steps):
        command = runner.act(episode.ranges[step], episode.pose[step], episode.path)
        assert runner.state is DriveState.DRIVE
        np.testing.assert_allclose(command, episode.action[step], rtol=1e-5, atol=1e-5)
    runner.act(episode.ranges[-1], episode.pose[-1], episode.path)
    assert episode.outcome == "success" and runner.state is DriveState.AT_GOAL


@pytest.fixture
def slow_wheels():
    """A dynamic window on slow wheels: 0.4 m/s more in each step."""
    cfg = compose("evaluate", ["policy=dwa", "robot=kobuki_wheeled"])
    robot = instantiate(cfg.robot)
    parts = (DynamicWindow(robot), instantiate(cfg.lidar), robot)
    return PolicyRunner(instantiate(cfg.transforms), *parts, SafetyLimits(min_measured_share=0.0))


def free():
    """A free circle whose wall behind is out of reach."""
    scan = clear()
    scan[0] = 3.4
    return scan


def test_a_controller_reads_its_last_action(slow_wheels):
    """It reaches full speed, and starts at rest after a reset."""
    for _ in range(2):
        speeds = [slow_wheels.act(free(), (0, 0, 0), AHEAD)[0] for _ in range(4)]
        assert speeds == pytest.approx([0.4, 0.8, 1.0, 1.0], abs=1e-3)
        slow_wheels.reset()


@pytest.mark.parametrize("state", ["blind", "blocked", "off_path", "at_goal"])
def test_last_action_after_a_stop_is_zero(slow_wheels, state):
    """The command that was driven, not the one that the controller asked for."""
    for _ in range(3):
        slow_wheels.act(free(), (0, 0, 0), AHEAD)
    ranges, pose = free(), {"off_path": (0, 5, 0), "at_goal": (2, 0.5, 0)}.get(state, (0, 0, 0))
    ranges[:100] = {"blind": np.nan, "blocked": -np.inf}.get(state, 3.5)
    for _ in range(2):
        assert slow_wheels.act(ranges, pose, AHEAD).tolist() == [0.0, 0.0]
        assert slow_wheels.state == state
    assert slow_wheels.act(free(), (0, 0, 0), AHEAD)[0] == pytest.approx(0.4, abs=1e-3)


def test_history_affects_commands_until_reset(runner):
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
def test_beam_without_return_accepts_any_value(runner, miss):
    commands = []
    for value in (3.5, miss):
        ranges = clear()
        ranges[100:200], ranges[300:340] = 0.8, value
        runner.reset()
        commands.append(runner.act(ranges, (0, 0, 0), AHEAD))
    assert np.array_equal(*commands)


@pytest.mark.parametrize(
    ("ranges", "pose", "path", "message"),
    [
        (clear(720), (0, 0, 0), AHEAD, r"ranges.shape=\[720\]: must be \[1440\]"),
        (clear(), (0, 0), AHEAD, "pose=.*: must be three finite numbers"),
        (clear(), (0, np.nan, 0), AHEAD, "pose=.*: must be three finite numbers"),
        (clear(), (0, 0, 90.0), AHEAD, "yaw=90: must be in rad"),
        (clear(), (0, 0, -45.0), AHEAD, "yaw=-45: must be in rad"),
        (clear(), (0, 0, 0), [(0, 0, 0)], r"path.shape=\[1, 3\]: must be \[P, 2\]"),
        (clear(), (0, 0, 0), np.zeros((201, 2)), "P from 1 to 200"),
        (clear(), (0, 0, 0), np.zeros((0, 2)), "P from 1 to 200"),
        (clear(), (0, 0, 6.3), AHEAD, "yaw=6.3: must be in rad"),
        (clear(), (0, 0, 0), [(0, 0), (np.inf, 0)], "path: must be finite"),
    ],
)
def test_invalid_scan_is_rejected_and_not_stored(runner, ranges, pose, path, message):
    runner.reset()
    expected = runner.act(clear(), (0, 0, 0), AHEAD)
    runner.reset()
    with pytest.raises(ValueError, match=message):
        runner.act(ranges, pose, path)
    assert runner.state is None
    assert np.array_equal(runner.act(clear(), (0, 0, 0), AHEAD), expected)


def test_transforms_for_another_lidar_are_rejected():
    bundle = load_bundle(ZOO / "paper")
    lidar = bundle.build("lidar", num_beams=1441)
    with pytest.raises(ValueError, match="1441"):
        PolicyRunner(bundle.build("transforms"), bundle.actor, lidar, bundle.build("robot"))


def test_one_pipeline_serves_two_robots():
    bundle = load_bundle(ZOO / "paper")
    transforms, lidar = bundle.build("transforms"), bundle.build("lidar")
    count = len(transforms)
    fast, slow = (
        PolicyRunner(transforms, bundle.actor, lidar, bundle.build("robot", max_speed=speed))
        for speed in (1.0, 0.3)
    )
    path = [(0.0, 0.0), (4.0, 0.0)]
    assert fast.act(clear(), (0, 0, 0), path)[0] > 0.9
    assert 0.25 < slow.act(clear(), (0, 0, 0), path)[0] <= 0.3
    assert fast.act(clear(), (0, 0, 0), path)[0] > 0.9
    assert len(transforms) == count and transforms.parent is None


class PoseBefore(Transform):
    """Write the pose of the step before."""

    def _step(self, tensordict, next_tensordict):
        return next_tensordict.set("pose_before", tensordict["pose"])

    def _reset(self, tensordict, tensordict_reset):
        return tensordict_reset.set("pose_before", tensordict_reset["pose"])

    def transform_observation_spec(self, observation_spec):
        return observation_spec.set("pose_before", observation_spec["pose"].clone())


def test_runner_stores_no_view_of_the_callers_arrays():
    drive = TensorDictModule(lambda pose: pose[:, :2], ["pose_before"], ["action"])
    bundle = load_bundle(ZOO / "paper")
    parts = (bundle.build(part) for part in ("lidar", "robot"))
    runner = PolicyRunner(compose_steps(before=PoseBefore()), drive, *parts)
    ranges, pose = clear().astype(np.float32), np.array([0.5, 0.25, 0.0], np.float32)
    path = np.array(AHEAD * 100, np.float32)  # 200 points: no padding
    runner.act(ranges, pose, path)
    for array in (ranges, pose, path):
        array[:] = 0.0  # as a driver reuses its buffers
    command = runner.act(clear(), (0, 0, 0), AHEAD)
    np.testing.assert_allclose(command, [0.75, 0.25 * np.pi], rtol=1e-6)


def test_path_that_is_planned_again_every_second_is_no_stall():
    """Navigation stacks send a path from the robot's place on, again and again."""
    bundle = load_bundle(ZOO / "paper")
    parts = (bundle.build(part) for part in ("lidar", "robot"))
    steps = compose_steps(waypoints=Waypoints(), stall=StallTimer())
    drive = TensorDictModule(lambda pose: torch.zeros(1, 2), ["pose"], ["action"])
    runner, stalled = PolicyRunner(steps, drive, *parts), []
    for step in range(40):  # 8 s: 4 s at 0.5 m/s, then standing
        x = 0.1 * min(step, 20)
        if step % 5 == 4:
            runner.new_path()
            begin = x
        path = [(begin if step > 3 else 0.0, 0.0), (6.0, 0.0)]
        runner.act(clear(), (x, 0.0, 0.0), path)
        stalled.append(float(runner.observation[keys.STALL][0, 1]))
    assert max(stalled[:21]) < 0.3
    assert stalled[-1] == pytest.approx(3.8)  # s, over three new paths


def test_new_path_clears_the_trail_of_returning_waypoints():
    steps = compose_steps(min_pool=MinPool(), waypoints=ReturningWaypoints())
    actor = TensorDictModule(lambda ranges: torch.zeros(1, 2), [keys.RANGES], [keys.ACTION])
    runner = PolicyRunner(steps, actor, Lidar(1440), DifferentialDrive())
    path, wall = [(0.0, 0.0), (1.0, 0.0), (1.0, 3.0)], np.full(1440, 0.4)
    for step in range(4):  # the path is out of sight, beyond a wall
        runner.act(wall + 0.001 * step, (1.0 + 0.5 * step, 0.0, 0.0), path)
    assert runner.observation[keys.TRAIL_STATE][0, 0] > 1
    runner.new_path()
    runner.act(wall, (2.5, 0.0, 0.0), [(2.5, -1.0), (4.0, -1.0)])
    assert runner.observation[keys.TRAIL_STATE][0, 0] == 1


class CountingNetwork(torch.nn.Module):
    """Answer with a speed that grows by 0.1 from call to call."""

    def forward(self, points, count):
        action = torch.zeros(*points.shape[:-2], 2)
        action[..., 0] = 0.2 * (count[..., 0] + 1.0) - 1.0  # in [-1, 1], 0 to 1 m/s
        return action, count + 1.0


@pytest.mark.parametrize("written", ["count", ("next", "count")])
def test_recurrent_state_is_passed_to_the_next_call(written):
    bundle = load_bundle(ZOO / "paper")
    actor = TensorDictModule(CountingNetwork(), ["points", "count"], ["action", written])
    steps = [
        *bundle.build("transforms"),
        TensorDictPrimer(count=Unbounded((1, 1)), expand_specs=True),
    ]
    runner = PolicyRunner(Compose(*steps), actor, bundle.build("lidar"), bundle.build("robot"))
    for _ in range(2):
        speeds = [runner.act(clear(), (0.0, 0.0, 0.0), AHEAD)[0] for _ in range(3)]
        assert speeds == pytest.approx([0.1, 0.2, 0.3])
        runner.reset()
