"""Stable-baselines3 trains, evaluates and films on the registered environment."""

import gymnasium
import numpy as np
import pages
import pytest

sb3 = pytest.importorskip("stable_baselines3")
from stable_baselines3.common.callbacks import EvalCallback  # noqa: E402
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.env_util import make_vec_env  # noqa: E402
from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.monitor import Monitor  # noqa: E402
from stable_baselines3.common.vec_env import SubprocVecEnv, VecVideoRecorder  # noqa: E402

import navrl  # noqa: E402, F401  registers the environment
from navrl.envs import Outcome  # noqa: E402

SMALL = ["scenario=corridor", "pool_size=4", "num_threads=1", "empty_share=0", "lidar.num_beams=36"]
SHORT = [*SMALL, "environment.time_limit_steps=3"]
STOP = np.zeros((2, 2), np.float32)


def make(overrides=SHORT, **kwargs):
    # The prefix lets a process that starts afresh import navrl first.
    return make_vec_env(
        "navrl:navrl/Navigation-v0", 2, env_kwargs={"overrides": overrides}, **kwargs
    )


def test_check_env():
    check_env(gymnasium.make("navrl/Navigation-v0", overrides=SMALL).unwrapped)


SLOW = pytest.mark.slow  # each process imports torch


@pytest.mark.parametrize("kind", [None, pytest.param(SubprocVecEnv, marks=SLOW)])
def test_environments_without_a_seed_differ(kind):
    env = make(SMALL, vec_env_cls=kind)
    first, second = env.reset()["ranges"]
    assert not np.array_equal(first, second)
    env.close()


@SLOW
def test_subprocess_worlds_are_generated_on_several_cores(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    overrides = [*SMALL[:1], "pool_size=40", "num_threads=2", *SMALL[3:]]
    env = make(overrides, vec_env_cls=SubprocVecEnv)
    assert env.reset()["ranges"].shape == (2, 36)
    env.close()


def test_vector_environment_reports_how_episodes_end():
    env = make()
    env.seed(0)
    env.reset()
    for _ in range(3):
        _, _, done, infos = env.step(STOP)
    assert done.all()
    for info in infos:
        assert info["outcome"] == Outcome.TIMEOUT
        assert not info["is_success"]
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"]["ranges"].shape == (36,)
        assert info["episode"]["l"] == 3


def test_ppo_trains_and_evaluates(tmp_path):
    env = make()
    model = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=16, n_epochs=1, device="cpu")
    callback = EvalCallback(make(), n_eval_episodes=2, eval_freq=8, log_path=str(tmp_path))
    model.learn(32, callback=callback)
    assert len(callback._is_success_buffer) == 2
    assert model.ep_success_buffer is not None and not any(model.ep_success_buffer)
    mean, _ = evaluate_policy(model, make(), n_eval_episodes=2)
    assert np.isfinite(mean)


def test_documented_training_is_compared_with_paper(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = pages.ROOT / "docs" / "gymnasium.md"
    exec(compile(pages.files(page)["train_ppo.py"], page.name, "exec"), {"__name__": "snippet"})
    assert "episodes ended" in capsys.readouterr().out
    block = next(text for text in pages.blocks(page, "text") if "policy=ppo.zip" in text)
    mine, paper, compared = block.splitlines()
    for command in (mine, paper):
        pages.run(command, "suite.num_episodes=2", "environment.time_limit_steps=3")
    pages.run(compared)
    assert "| `ppo` | 2 |" in capsys.readouterr().out


def test_sac_trains_on_the_transformed_observation():
    env = make_vec_env(
        "navrl/Navigation-v0",
        1,
        env_kwargs={
            "overrides": ["scenario=corridor", "pool_size=4", "environment.time_limit_steps=3"],
            **{"observation": "transformed", "action": "normalized"},
        },
    )
    model = sb3.SAC("MultiInputPolicy", env, learning_starts=4, batch_size=4, buffer_size=50)
    model.learn(8)
    assert model.action_space.low.tolist() == [-1.0, -1.0]
    assert sorted(model.observation_space.spaces) == ["spatial", "temporal", "waypoints_scaled"]


def test_monitor_logs_success(tmp_path):
    base = gymnasium.make("navrl/Navigation-v0", overrides=SHORT)
    env = Monitor(base, str(tmp_path / "log"), info_keywords=("is_success", "outcome"))
    env.reset(seed=0)
    for _ in range(3):
        env.step(STOP[0])
    env.close()
    last = (tmp_path / "log.monitor.csv").read_text().splitlines()[-1]
    assert last.endswith(f"False,{int(Outcome.TIMEOUT)}")


def test_vector_video_recorder(tmp_path):
    pytest.importorskip("moviepy")
    env = VecVideoRecorder(
        make(), str(tmp_path), record_video_trigger=lambda step: step == 0, video_length=5
    )
    env.reset()
    for _ in range(6):
        env.step(STOP)
    env.close()
    (video,) = tmp_path.glob("*.mp4")
    assert video.stat().st_size > 1000
