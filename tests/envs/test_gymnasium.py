"""The registered gymnasium environment: contract, info, seeds, rendering, refused input."""

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from nightly import mostly

import navrl
from navrl.config import compose, instantiate
from navrl.envs import Outcome
from navrl.envs.gymnasium import GymnasiumNavigation
from navrl.evaluation.recorder import record_episode
from navrl.factory import make_evaluated_policy, make_gymnasium_env
from navrl.factory.overrides import EFFECTIVE
from navrl.policies import load_actor
from navrl.viz.live import FRAME_PIXELS, LiveScene

SMALL = ["scenario=corridor", "pool_size=4", "num_threads=1", "empty_share=0"]
STOP, AHEAD = np.zeros(2, np.float32), np.array([1.0, 0.0], np.float32)


def make(*overrides, **kwargs):
    return gymnasium.make("navrl/Navigation-v0", overrides=[*SMALL, *overrides], **kwargs)


@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
def test_check_env(render_mode):
    check_env(make(render_mode=render_mode).unwrapped)


# --- seeds ---------------------------------------------------------------------------------------


def test_seed_fixes_all_episodes_that_follow():
    def play():
        env = make()
        starts = [env.reset(seed=7)[0]["pose"], *(env.reset()[0]["pose"] for _ in range(4))]
        return np.stack(starts)

    assert np.array_equal(play(), play())


def test_environments_without_a_seed_differ():
    first, second = (make().reset()[0]["ranges"] for _ in range(2))
    assert not np.array_equal(first, second)


def test_seed_override_chooses_the_worlds_and_not_the_episodes():
    first, second = (make("seed=3").reset()[0]["ranges"] for _ in range(2))
    assert not np.array_equal(first, second)


# --- info and end --------------------------------------------------------------------------------


def drive_to_the_goal(env):
    """Follow the path, and return every step's result."""
    observation, _ = env.reset(seed=0)
    results = []
    while not results or not (results[-1][2] or results[-1][3]):
        (x, y, yaw), path = observation["pose"], observation["path"]
        nearest = np.linalg.norm(path - (x, y), axis=-1).argmin()
        ahead = path[min(nearest + 4, len(path) - 1)] - (x, y)
        turn = (np.arctan2(ahead[1], ahead[0]) - yaw + np.pi) % (2 * np.pi) - np.pi
        results.append(env.step(np.array([0.5 * (abs(turn) < 0.5), 2 * turn], np.float32)))
        observation = results[-1][0]
    return results


def test_info_has_numeric_outcome_and_success_at_the_goal():
    results = drive_to_the_goal(make("empty_share=1"))
    infos = [result[4] for result in results]
    assert [Outcome(info["outcome"]).name for info in infos[-2:]] == ["RUNNING", "SUCCESS"]
    assert [bool(info["is_success"]) for info in infos] == [False] * (len(infos) - 1) + [True]
    terminated, truncated = results[-1][2:4]
    assert terminated and not truncated
    for info in infos:
        assert info["outcome"].dtype == np.int64
        assert info["is_success"].dtype == bool
        assert info["reward_progress"].dtype == np.float32


def test_reward_is_the_sum_of_the_terms_in_info():
    env = make()
    env.reset(seed=1)
    for _ in range(5):
        _, reward, _, _, info = env.step(AHEAD)
        terms = [value for name, value in info.items() if name.startswith("reward_")]
        assert reward == pytest.approx(sum(terms), abs=1e-5)


def test_time_limit_truncates():
    env = make("environment.time_limit_steps=2")
    env.reset(seed=0)
    env.step(STOP)
    _, _, terminated, truncated, info = env.step(STOP)
    assert truncated and not terminated
    assert info["outcome"] == Outcome.TIMEOUT


@pytest.mark.parametrize("ending", ["collision", "timeout"])
def test_step_after_the_end_raises(ending):
    env = make("environment.time_limit_steps=2") if ending == "timeout" else make()
    env.reset(seed=0)
    over, count = False, 0
    while not over:
        _, _, terminated, truncated, _ = env.step(STOP if ending == "timeout" else AHEAD)
        over, count = terminated or truncated, count + 1
    assert (terminated, truncated) == (ending == "collision", ending == "timeout")
    with pytest.raises(ResetNeeded, match=r"call reset\(\) first"):
        env.step(STOP)
    env.reset()
    env.step(STOP)


def test_step_before_the_first_reset_raises():
    with pytest.raises(ResetNeeded):
        make().unwrapped.step(STOP)


def test_spaces_have_the_limits_of_robot_and_lidar():
    env = make("lidar.num_beams=90", "lidar.max_range=2.0")
    ranges = env.observation_space["ranges"]
    assert (ranges.shape, ranges.low.min(), ranges.high.max()) == ((90,), 0.0, 2.0)
    assert env.observation_space["path"].shape == (200, 2)
    assert env.action_space.low.tolist() == pytest.approx([0.0, -np.pi])
    assert env.action_space.high.tolist() == pytest.approx([1.0, np.pi])


def test_caller_may_change_an_observation():
    env = make()
    observation, _ = env.reset(seed=0)
    kept = {key: value.copy() for key, value in observation.items()}
    for value in observation.values():
        value[:] = 0.0
    after = env.step(STOP)[0]
    assert np.array_equal(after["path"], kept["path"])
    assert np.array_equal(after["pose"], kept["pose"])


@pytest.mark.parametrize("is_reset", [False, True])
def test_close_frees_the_simulator(is_reset):
    env = make("simulator=bullet")
    if is_reset:
        env.reset(seed=0)
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.unwrapped.reset()


# --- rendering -----------------------------------------------------------------------------------


@pytest.mark.parametrize("simulator", mostly(["batched", "bullet"], ["batched"]))
def test_frames_show_the_episode(simulator):
    env = make(f"simulator={simulator}", render_mode="rgb_array")
    env.reset(seed=0)
    frames = [env.render()]
    for _ in range(3):
        env.step(AHEAD)
        frames.append(env.render())
    env.reset()
    frames.append(env.render())
    for frame in frames:
        assert frame.shape == (FRAME_PIXELS, FRAME_PIXELS, 3)
        assert frame.dtype == np.uint8
        assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 5
    assert all((a != b).any() for a, b in zip(frames, frames[1:], strict=False))


def test_renderer_records_the_episode_so_far(monkeypatch):
    seen = []
    monkeypatch.setattr(LiveScene, "draw", lambda self, recording: seen.append(recording))
    env = make("environment.time_limit_steps=2", render_mode="rgb_array")
    start, _ = env.reset(seed=0)
    for _ in range(2):
        after = env.step(AHEAD)[0]
        env.render()
    assert [recording.outcome for recording in seen] == ["running", "timeout"]
    last = seen[-1]
    assert last.num_steps == 2 and last.action.tolist() == [[1.0, 0.0]] * 2
    assert np.array_equal(last.pose[[0, 2]], [start["pose"], after["pose"]])
    assert np.array_equal(last.ranges[2], after["ranges"])
    assert np.array_equal(last.path, start["path"]) and np.array_equal(last.goal, last.path[-1])
    assert len(last.walls) > 0 and np.isfinite(last.pedestrian_boxes).any()


def test_rendering_changes_no_observation():
    plain, drawn = make(), make(render_mode="rgb_array")
    for env in (plain, drawn):
        env.reset(seed=2)
    for _ in range(4):
        drawn.render()
        first, second = plain.step(AHEAD)[0], drawn.step(AHEAD)[0]
        assert all(np.array_equal(first[key], second[key]) for key in first)


def test_frames_per_second_follow_the_time_step():
    assert make().metadata["render_fps"] == 5
    assert make("simulator.time_step_s=0.15").metadata["render_fps"] == 7


def test_render_without_a_mode_warns_and_returns_none():
    env = make()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.unwrapped.render() is None


def test_render_before_the_first_reset_raises():
    with pytest.raises(ResetNeeded):
        make(render_mode="rgb_array").unwrapped.render()


def test_human_mode_uses_gymnasiums_window():
    with pytest.warns(UserWarning, match="HumanRendering"):
        env = make(render_mode="human")
    assert env.render_mode == "human"
    assert env.unwrapped.render_mode == "rgb_array"


# --- refused input -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("transforms=robust", "transforms"),
        ("transforms.icp_align=null", "transforms"),
        ("num_worlds=8", "num_worlds"),
        ("suite=table1", "suite"),
        ("suite.num_episodes=3", "suite"),
        ("network=small", "network"),
        ("curriculum.levels=[3]", "curriculum"),
        ("device=cuda", "device"),
        ("hardware=gpu", "hardware"),
        ("simulator@final_simulator=bullet", "final_simulator"),
        ("+typo=1", "typo"),
        ("~transforms.tagd", "transforms"),
    ],
)
def test_override_without_effect_is_rejected(override, key):
    with pytest.raises(ValueError, match=rf"overrides='.*': must .*; {key} has no effect"):
        make(override)


@pytest.mark.parametrize("key", EFFECTIVE)
def test_effective_overrides_are_configuration_keys(key):
    choices = {*compose("train").keys(), "experiment"}
    assert key in choices


def test_effective_overrides_have_their_effect():
    env = make("robot=kobuki_wheeled", "lidar.num_beams=90", "lidar.max_range=2.0", "reward=paper")
    _, info = env.reset(seed=0)
    assert env.observation_space["ranges"].shape == (90,)
    assert env.observation_space["ranges"].high.max() == 2.0
    assert "reward_progress" not in info


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"overrides": "scenario=corridor"}, "overrides='scenario=corridor': must be a list"),
        ({"overrides": ["pool_size=many"]}, "pool_size=many: must be int"),
        ({"render_mode": "ansi"}, "render_mode='ansi': must be one of None, 'rgb_array'"),
    ],
)
def test_wrong_values_are_named(kwargs, message):
    with pytest.raises(ValueError, match=message):
        make_gymnasium_env(**kwargs)


def test_unknown_keyword_is_a_type_error():
    """Stable-baselines3 and TorchRL try again without their own keywords on this type only."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'typo'"):
        gymnasium.make("navrl/Navigation-v0", typo=1)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"suite": "table1"}, r"options=\{'suite': 'table1'\}: must be None, empty, or have suite"),
        ({"suite": "tabel1", "index": 0}, "options.suite='tabel1': must be .*did you mean table1"),
        ({"suite": "smoke", "index": 9_999}, "index 9999: suite"),
        ({"suite": "smoke", "index": [0, 1]}, r"options.index=\[0, 1\]: must be an integer$"),
    ],
)
def test_wrong_reset_options_are_named(options, message):
    env = make()
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)
    env.reset(options={})


def test_frozen_episode_is_that_of_the_evaluation():
    evaluated = make_evaluated_policy(compose("evaluate", ["policy=stand_still", "num_worlds=1"]))
    (scenario,) = instantiate(compose("evaluate", ["suite=table1"]).suite).scenarios([3])
    recorded = record_episode(evaluated.env, evaluated.policy, scenario)
    env = gymnasium.make("navrl/Navigation-v0", overrides=SMALL)
    for _ in range(2):
        env.reset()  # another episode before
        played = [env.reset(options={"suite": "table1", "index": 3})[0]]
        played += [env.step(STOP)[0] for _ in range(3)]
        for observation, ranges, pose in zip(played, recorded.ranges, recorded.pose, strict=False):
            assert np.array_equal(observation["ranges"], ranges)
            assert np.array_equal(observation["pose"], pose.astype(np.float32))
    assert not np.array_equal(env.reset()[0]["ranges"], played[0]["ranges"])


# --- what the networks read, and what they write -------------------------------------------------


@pytest.mark.parametrize("action", ["physical", "normalized"])
def test_transformed_observation_passes_check_env(action):
    check_env(make(observation="transformed", action=action).unwrapped)


def test_transformed_observation_is_that_of_training():
    gym_env = make(observation="transformed", action="normalized")
    observation, _ = gym_env.reset(seed=5)
    assert {key: box.shape for key, box in gym_env.observation_space.items()} == {
        **{"spatial": (180, 2), "temporal": (30, 4), "waypoints_scaled": (5, 2)}
    }
    assert gym_env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (2,))
    env = navrl.make(SMALL, num_worlds=1, seed=None)
    env.set_seed(5)
    td = env.reset()
    action = np.array([0.4, -0.2], np.float32)
    for _ in range(4):
        for key, value in observation.items():
            assert np.array_equal(value, td[key][0].numpy())
        observation, reward, *_ = gym_env.step(action)
        td = env.step(td.set("action", torch.from_numpy(action)[None]))["next"]
        assert reward == td["reward"].item()


def test_normalized_action_is_a_scaled_command():
    scaled, physical = make(action="normalized"), make()
    for env in (scaled, physical):
        env.reset(seed=2)
    for _ in range(3):
        first = scaled.step(np.array([0.0, 0.5], np.float32))[0]
        second = physical.step(np.array([0.5, 0.5 * np.pi], np.float32))[0]
        assert all(np.allclose(first[key], second[key], atol=1e-5) for key in first)


def test_networks_input_follows_the_experiment():
    env = gymnasium.make(
        "navrl/Navigation-v0",
        overrides=["experiment=liang", "pool_size=2", "num_threads=1"],
        observation="transformed",
    )
    agent = load_actor("liang")
    assert list(env.observation_space) == sorted(agent.in_keys)


@pytest.mark.parametrize("name", ["observation", "action"])
def test_unknown_choices_are_named(name):
    with pytest.raises(ValueError, match=f"{name}='pixels': must be one of '.*', '.*'"):
        make_gymnasium_env(**{name: "pixels"})


@pytest.mark.parametrize("action", [[0.0, 0.0, 0.0], [[0.0], [0.0]], 0.0])
def test_action_of_another_shape_is_rejected(action):
    env = make().unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"action.shape=.*: must be \(2,\)"):
        env.step(np.array(action, np.float32))


def test_adapter_needs_one_world_on_the_cpu():
    with pytest.raises(ValueError, match=r"env.batch_size=\[2\]: must be \[1\]"):
        GymnasiumNavigation(SimpleNamespace(batch_size=torch.Size([2])))
    device = torch.device("cuda")
    with pytest.raises(ValueError, match=r"env.device=cuda: must be cpu"):
        GymnasiumNavigation(SimpleNamespace(batch_size=torch.Size([1]), device=device))
