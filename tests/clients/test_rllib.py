"""Ray RLlib trains and evaluates on the registered environment."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation
from pages import files

pytest.importorskip("ray.rllib", exc_type=ImportError, reason="needs ray[rllib]")
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

import navrl  # noqa: F401  registers the environment

OVERRIDES = ["scenario=corridor", "pool_size=4", "num_threads=1", "environment.time_limit_steps=5"]


def make(config):
    env = gymnasium.make(
        "navrl/Navigation-v0",
        overrides=config["overrides"],
        observation="transformed",
        action="normalized",
    )
    return FlattenObservation(env)


@pytest.mark.slow
def test_rllib_trains_on_the_flattened_observation(tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    register_env("navrl", make)
    config = (
        PPOConfig()
        .environment("navrl", env_config={"overrides": OVERRIDES})
        .env_runners(num_env_runners=0, num_envs_per_env_runner=2, rollout_fragment_length=20)
        .training(train_batch_size_per_learner=40, minibatch_size=20, num_epochs=1)
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    result = algorithm.train()
    algorithm.stop()
    runners = result["env_runners"]
    assert runners["num_env_steps_sampled"] >= 40 and runners["num_episodes"] >= 4
    assert runners["episode_len_max"] == 5 and np.isfinite(runners["episode_return_mean"])


@pytest.mark.slow
def test_script_of_the_page_runs(capsys):
    page = Path(__file__).parents[2] / "docs" / "gymnasium.md"
    exec(compile(files(page)["train_rllib.py"], page.name, "exec"), {"__name__": "snippet"})
    assert capsys.readouterr().out
