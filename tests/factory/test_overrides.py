"""An override has an effect or is an error, before anything is played."""

import json

import pytest

from navrl.config import compose
from navrl.factory import make_evaluated_policy
from navrl.factory.overrides import check_drawing, check_measured, check_policy
from navrl.jobs import record, run_evaluation
from navrl.sim import LimitedDrive
from navrl.worlds import Suite

TINY = ["suite=smoke", "suite.num_episodes=2", "num_worlds=2", "num_threads=1"]
TINY += ["environment.time_limit_steps=4", "progress_bar=false"]


def config(*overrides, command="evaluate"):
    words = TINY if command == "evaluate" else [word for word in TINY if "progress" not in word]
    words = [word for word in words if command == "evaluate" or "num_worlds" not in word]
    return compose(command, [*words, *overrides])


@pytest.mark.parametrize("command", ["evaluate", "play"])
@pytest.mark.parametrize(
    ("word", "key"),
    [
        ("lidar.num_beams=720", "lidar.num_beams=720"),
        ("lidar=noiseless", "lidar.noise=none"),
        ("robot=kobuki_wheeled", "robot."),
        ("transforms.min_pool.group_size=4", "transforms.min_pool.group_size=4"),
        ("transforms=robust", "transforms."),
    ],
)
def test_parts_of_a_bundle_cannot_be_overridden(command, word, key):
    with pytest.raises(ValueError, match=rf"^{key}.*no effect.*\+change\.{key}"):
        make_evaluated_policy(config("policy=paper", word, command=command))


@pytest.mark.parametrize(
    ("policy", "word", "part"),
    [("paper", "+change.controller.waypoint=2", "controller"), ("dwa", "+change.sim.x=1", "sim")],
)
def test_a_change_of_an_unknown_part_is_an_error(policy, word, part):
    with pytest.raises(ValueError, match=rf"change\.{part}: .* change\.transforms"):
        make_evaluated_policy(config(f"policy={policy}", word))


def test_a_change_that_does_not_fit_the_network_is_an_error(tmp_path):
    cfg = config("policy=paper", "+change.lidar.num_beams=720", "num_processes=2")
    with pytest.raises(ValueError, match=r"change: lidar.num_beams=720: the network of policy=pa"):
        run_evaluation(cfg, tmp_path)
    assert not list(tmp_path.iterdir())


def test_changes_of_a_controllers_parts_have_an_effect():
    words = ("+change.lidar.num_beams=720", "+change.robot.max_speed=0.4")
    env = make_evaluated_policy(
        config("policy=dwa", *words, "+change.transforms.tagd.num_groups=20")
    ).env
    assert env.base_env.simulator.lidar.num_beams == 720
    assert env.base_env.simulator.robot.max_speed == pytest.approx(0.4)
    assert env.observation_spec["tagd"].shape == (2, 20, 4)


def test_overridden_parts_of_a_controller_have_an_effect():
    env = make_evaluated_policy(config("policy=dwa", "lidar.num_beams=720")).env
    assert env.base_env.simulator.lidar.num_beams == 720


def test_simulator_and_environment_have_equal_worlds():
    with pytest.raises(ValueError, match=r"simulator.num_worlds=7: no effect, num_worlds=7"):
        make_evaluated_policy(config("policy=random", "simulator.num_worlds=7"))


def test_a_reward_without_recordings_is_an_error():
    with pytest.raises(ValueError, match=r"reward\..*no effect without recordings"):
        check_policy(config("policy=random", "reward=goal"), is_bundle=False)
    check_policy(config("policy=random", "reward=goal", "recordings=all"), is_bundle=False)


def test_one_episode_is_played_in_one_world():
    with pytest.raises(ValueError, match=r"num_worlds=5: .* must be 1"):
        record(config("policy=random", "num_worlds=5", command="play"))


def test_overrides_of_a_recording_are_rejected():
    check_drawing(compose("play", ["recording=file.npz", "frames_per_s=2"]))
    for word in ("episode=3", "policy=dwa", "lidar.num_beams=9", "suite.seed=4"):
        with pytest.raises(ValueError, match=rf"^{word}: no effect with recording=file.npz"):
            check_drawing(compose("play", ["recording=file.npz", word]))


def test_unused_override_of_a_benchmark_is_an_error():
    check_measured(["transforms=robust", "replay.batch_size=4", "+effort.x=1", "pool_size=3"])
    words = ["suite=table1", "suite.seed=3", "simulator@final_simulator=bullet", "resume=a"]
    words += ["replay.capacity=7", "schedule.total_frames=5", "+deployment.transforms.x=1"]
    for word in words:
        with pytest.raises(ValueError, match="no effect"):
            check_measured([word])


def test_a_suite_without_episodes_names_its_number():
    with pytest.raises(ValueError, match=r"^num_episodes=0: must be > 0$"):
        Suite("a", 0, 0, None)
    with pytest.raises(ValueError, match=r"^seed=-1: must be >= 0$"):
        Suite("a", -1, 1, None)


def test_latency_is_of_the_changed_policy(tmp_path, monkeypatch):
    from navrl.factory.policy import make_runner

    assert make_runner(config("policy=dwa")) is None
    runner = make_runner(config("policy=paper", "+change.robot.max_speed=0.4"))
    command = runner.act([3.5] * 1440, pose=(0, 0, 0), path=[(0, 0), (4, 0)])
    assert command[0] <= 0.4 + 1e-6
    words = ("policy=paper", "+transforms/steps@change.transforms=shield")
    assert "ActionShield" in repr(make_runner(config(*words)).transform)


def test_changes_are_named_in_the_summary(tmp_path):
    run_evaluation(config("policy=stand_still", "+change.lidar.num_beams=720"), tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["change"] == {"lidar.num_beams": 720} and summary["errors"] == 0


@pytest.mark.parametrize("policy", ["paper", "dwa"])
def test_change_to_another_class_replaces_the_part(policy):
    env = make_evaluated_policy(config(f"policy={policy}", "+robot@change.robot=turtlebot3")).env
    robot = env.base_env.simulator.robot
    assert isinstance(robot, LimitedDrive) and robot.max_speed == 0.22
