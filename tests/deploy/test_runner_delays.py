"""The runner on a robot whose commands and scans are late."""

import pytest
import torch
from nightly import mostly

from navrl import factory, keys
from navrl.config import compose
from navrl.deploy import PolicyRunner, SafetyLimits
from navrl.factory.environment import make_pool
from navrl.policies import ZOO

ADDED = "[motion_compensation,motion_prediction,base_shield_ahead]"


@pytest.mark.parametrize("robot", mostly(["kobuki", "turtlebot2"], ["kobuki"]))
def test_commands_equal_those_in_simulation(robot, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cfg = compose(
        "evaluate",
        [
            *("policy=paper", "timing=ordinary", "num_worlds=1", "num_threads=1"),
            f"+transforms/steps@change.transforms={ADDED}",
            f"+robot@change.robot={robot}",
        ],
    )
    made = factory.make_evaluated_policy(cfg)
    env, simulator = made.env, made.env.simulator
    training = compose("train", ["scenario=corridor", "pool_size=2", "num_threads=1"])
    env.base_env.scenarios = make_pool(training)
    env.set_seed(1)
    pipeline, lidar = env.transform[:-1], simulator.lidar
    runner = PolicyRunner(
        pipeline, made.policy, lidar, simulator.robot, SafetyLimits.simulated(), simulator.delays
    )
    now = env.reset()
    for _ in range(6):
        seen = (now[key][0].numpy() for key in (keys.RANGES, keys.POSE, keys.PATH))
        motion = {"velocity": now["velocity"][0], "scan_motion": now["scan_motion"][0]}
        command = runner.act(*seen, **motion)
        stepped = env.step(made.policy(now))
        driven = stepped["next", keys.COMMAND][0]
        torch.testing.assert_close(torch.from_numpy(command), driven, atol=2e-3, rtol=0)
        now = stepped["next"].exclude("reward")
    assert driven.abs().max() > 0.1


def test_prediction_needs_the_velocity():
    from navrl.policies import load_bundle
    from navrl.transforms import MotionPrediction

    bundle = load_bundle(ZOO / "paper")
    pipeline = bundle.build("transforms")
    pipeline.insert(0, MotionPrediction())
    runner = PolicyRunner(pipeline, bundle.actor, bundle.build("lidar"), bundle.build("robot"))
    with pytest.raises(ValueError, match="velocity=None: must be"):
        runner.act([2.0] * 1440, (0.0, 0.0, 0.0), [(0.0, 0.0), (4.0, 0.0)])
