"""Gymnasium's own vector environments and recorders on the registered environment."""

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import RecordEpisodeStatistics, RecordVideo
from torchrl.envs import GymWrapper

import navrl  # noqa: F401  registers the environment
from navrl.envs import Outcome

SMALL = ["scenario=corridor", "pool_size=4", "num_threads=1", "empty_share=0"]
SHORT = [*SMALL, "environment.time_limit_steps=3"]
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]
STOP = np.zeros((2, 2), np.float32)


def make_one(overrides=SMALL, **kwargs):
    return gymnasium.make("navrl/Navigation-v0", overrides=overrides, **kwargs)


def make_vector(kind, mode=AutoresetMode.NEXT_STEP, overrides=SMALL):
    makers = [lambda: make_one(overrides)] * 2
    if kind == "sync":
        return SyncVectorEnv(makers, autoreset_mode=mode)
    return AsyncVectorEnv(makers, autoreset_mode=mode, context=kind)


SLOW = pytest.mark.slow  # each process imports torch


@pytest.mark.parametrize("kind", ["sync", "fork", pytest.param("forkserver", marks=SLOW)])
def test_environments_without_a_seed_differ(kind):
    env = make_vector(kind)
    first, second = env.reset()[0]["ranges"]
    assert not np.array_equal(first, second)
    for _ in range(3):
        first, second = env.step(STOP)[0]["ranges"]
        assert not np.array_equal(first, second)
    env.close()


@pytest.mark.parametrize("mode", ["sync", pytest.param("async", marks=SLOW)])
def test_make_vec_without_a_seed_differs(mode):
    env = gymnasium.make_vec(
        "navrl:navrl/Navigation-v0", num_envs=2, vectorization_mode=mode, overrides=SMALL
    )
    first, second = env.reset()[0]["ranges"]
    env.close()
    assert not np.array_equal(first, second)


@pytest.mark.parametrize("kind", ["sync", "fork"])
def test_seed_fixes_a_vector_of_different_episodes(kind):
    starts = []
    for _ in range(2):
        env = make_vector(kind)
        starts.append(env.reset(seed=5)[0]["ranges"])
        env.close()
    assert np.array_equal(*starts)
    assert not np.array_equal(*starts[0])


@pytest.mark.parametrize("kind", ["sync", "fork"])
@pytest.mark.parametrize("mode", MODES)
def test_info_is_numeric_at_the_end_of_an_episode(kind, mode):
    env = make_vector(kind, mode, SHORT)
    env.reset(seed=0)
    for _ in range(3):
        _, _, terminated, truncated, info = env.step(STOP)
    assert truncated.all() and not terminated.any()
    if mode == AutoresetMode.SAME_STEP:
        assert info["outcome"].tolist() == [Outcome.RUNNING] * 2
        info = info["final_info"]
    assert info["outcome"].dtype == np.int64
    assert info["outcome"].tolist() == [Outcome.TIMEOUT] * 2
    assert info["is_success"].dtype == bool and not info["is_success"].any()
    assert info["reward_guidance"].dtype == np.float32
    _, _, terminated, truncated, info = env.step(STOP)
    assert not terminated.any() and not truncated.any()
    assert info["outcome"].tolist() == [Outcome.RUNNING] * 2
    env.close()


def test_autoreset_can_be_left_to_the_caller():
    env = make_vector("sync", AutoresetMode.DISABLED, SHORT)
    env.reset(seed=0)
    for _ in range(3):
        _, _, _, truncated, _ = env.step(STOP)
    env.reset(options={"reset_mask": truncated})
    assert not env.step(STOP)[3].any()
    env.close()


def test_episode_statistics():
    env = RecordEpisodeStatistics(make_one(SHORT))
    env.reset(seed=0)
    total = 0.0
    for _ in range(3):
        _, reward, _, _, info = env.step(STOP[0])
        total += reward
    assert info["episode"]["l"] == 3
    assert info["episode"]["r"] == pytest.approx(total)


def test_record_video(tmp_path):
    pytest.importorskip("moviepy")
    env = RecordVideo(make_one(SHORT, render_mode="rgb_array"), str(tmp_path))
    env.reset(seed=0)
    for _ in range(3):
        env.step(STOP[0])
    env.close()
    (video,) = tmp_path.glob("*.mp4")
    assert video.stat().st_size > 1000


def test_human_window(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = make_one(SHORT, render_mode="human")
    env.reset(seed=0)
    env.step(STOP[0])
    assert env.window is not None
    env.close()


# --- the batched vector environment --------------------------------------------------------------


def make_batched(overrides=SHORT, num_envs=3, **kwargs):
    return gymnasium.make_vec(
        "navrl/Navigation-v0",
        num_envs,
        vectorization_mode="vector_entry_point",
        overrides=overrides,
        **kwargs,
    )


def cleanrl_chain(seed):
    """The wrappers of CleanRL's ``ppo_continuous_action.py``, in its order."""
    env = gymnasium.make(
        "navrl/Navigation-v0", overrides=SHORT, observation="transformed", action="normalized"
    )
    env = wrappers.FlattenObservation(env)
    env = wrappers.RecordEpisodeStatistics(env)
    env = wrappers.ClipAction(env)
    env = wrappers.NormalizeObservation(env)
    env = wrappers.TransformObservation(
        env, lambda values: np.clip(values, -10, 10), env.observation_space
    )
    env = wrappers.NormalizeReward(env, gamma=0.98)
    env = wrappers.TransformReward(env, lambda reward: np.clip(reward, -10, 10))
    env.action_space.seed(seed)
    return env


def test_cleanrls_chain_of_wrappers():
    envs = SyncVectorEnv([lambda: cleanrl_chain(0)] * 2)
    observations, _ = envs.reset(seed=1)
    assert observations.shape == (2, 180 * 2 + 30 * 4 + 5 * 2)
    lengths = []
    for _ in range(8):
        observations, rewards, _, _, infos = envs.step(envs.action_space.sample())
        assert np.isfinite(observations).all() and np.isfinite(rewards).all()
        lengths += infos["episode"]["l"][infos["_episode"]].tolist() if "episode" in infos else []
    assert lengths == [3] * 4


def test_vector_wrappers_on_the_batched_environment(tmp_path):
    envs = make_batched(observation="transformed", action="normalized")
    envs = wrappers.vector.RecordEpisodeStatistics(envs)
    envs = wrappers.vector.FlattenObservation(envs)
    envs = wrappers.vector.ClipAction(envs)
    envs = wrappers.vector.NormalizeObservation(envs)
    envs = wrappers.vector.NormalizeReward(envs)
    observations, _ = envs.reset(seed=1)
    assert observations.shape == (3, 490)
    lengths = []
    for _ in range(8):
        observations, _, _, _, infos = envs.step(envs.action_space.sample())
        lengths += infos["episode"]["l"][infos["_episode"]].tolist() if "episode" in infos else []
    assert np.isfinite(observations).all() and lengths == [3] * 6


def test_record_video_of_the_batched_environment(tmp_path):
    pytest.importorskip("moviepy")
    envs = wrappers.vector.RecordVideo(
        make_batched(num_envs=2, render_mode="rgb_array"), str(tmp_path), video_length=4
    )
    envs.reset(seed=0)
    for _ in range(5):
        envs.step(envs.action_space.sample())
    envs.close()
    videos = list(tmp_path.glob("*.mp4"))
    assert videos and all(video.stat().st_size > 1000 for video in videos)


def test_torchrl_wraps_the_batched_environment():
    env = GymWrapper(make_batched(autoreset_mode="SameStep"))
    batch = env.rollout(7, break_when_any_done=False)
    assert batch["next", "done"].squeeze(-1).sum().item() == 6
    assert batch["next", "outcome"].tolist() == [[0, 0, Outcome.TIMEOUT] * 2 + [0]] * 3
