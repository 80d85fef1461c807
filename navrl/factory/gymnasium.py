"""Construction of the gymnasium environment from Hydra overrides."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from gymnasium.error import ResetNeeded
from tensordict import TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.config import check_types, compose
from navrl.envs import NavigationEnv, Outcome
from navrl.envs.gymnasium import GymnasiumNavigation
from navrl.evaluation.recording import Recording
from navrl.factory.environment import make_navigation_env, make_pool
from navrl.viz.live import LiveScene
from navrl.worlds import Scenario

EFFECTIVE = (
    *(
        "scenario",
        "simulator",
        "robot",
        "lidar",
        "localization",
        "reward",
        "environment",
        "experiment",
    ),
    *("seed", "pool_size", "empty_share", "num_threads"),
)
"""Keys of ``conf/train.yaml`` that affect the environment."""


def make_gymnasium_env(
    overrides: Sequence[str] = (), render_mode: str | None = None
) -> GymnasiumNavigation:
    """Build the environment behind ``gymnasium.make("navrl/Navigation-v0")``.

    An unknown keyword raises Python's TypeError, on which libraries with additional keywords
    (stable-baselines3, TorchRL) retry without them.

    Args:
        overrides: Hydra overrides of ``conf/train.yaml``, e.g. ``["scenario=corridor",
            "simulator=bullet"]``. Only those that affect the environment are accepted. ``seed`` is
            that of the pool of worlds; ``reset(seed=...)`` selects from the pool.
        render_mode: ``"rgb_array"`` or ``None``; ``gymnasium.make`` provides ``"human"`` by the
            former if pygame is installed.

    Returns:
        One world with the paper's raw observations.

    Raises:
        ValueError: If an override would have no effect, or a value is not allowed.
    """
    modes = GymnasiumNavigation.metadata["render_modes"]
    if render_mode is not None and render_mode not in modes:
        raise ValueError(f"render_mode={render_mode!r}: must be None or one of {modes}")
    _check_overrides(overrides)
    cfg = compose("train", list(overrides))
    env = make_navigation_env(cfg, 1, make_pool(cfg), seed=None)
    return GymnasiumNavigation(env, EpisodeRenderer(env) if render_mode else None)


make_gymnasium_env.metadata = GymnasiumNavigation.metadata  # read by gymnasium.make


def _check_overrides(overrides: Sequence[str]) -> None:
    if isinstance(overrides, str):
        raise ValueError(f"overrides={overrides!r}: must be a list of strings")
    for override in overrides:
        package = override.partition("=")[0].rpartition("@")[2].lstrip("+~")
        key = re.split("[./]", package)[0]
        if key not in EFFECTIVE:
            raise ValueError(
                f"overrides={override!r}: must be of {', '.join(EFFECTIVE)}; {key} has no effect "
                f"on this environment"
            )
    check_types("train", overrides)


class EpisodeRenderer:
    """Renderer of the running episode by :mod:`navrl.viz`.

    Args:
        env: Environment whose first world is drawn.
    """

    def __init__(self, env: NavigationEnv) -> None:
        self._env = env
        self._scene: LiveScene | None = None
        self._outcome = Outcome.RUNNING
        self._series: dict[str, list[np.ndarray]] = {}

    def start(self, observation: TensorDictBase) -> None:
        """Start with the observation of a reset, ``[N]``."""
        self._series = {
            name: [] for name in (keys.POSE, keys.RANGES, keys.PEDESTRIAN_BOXES, keys.ACTION)
        }
        self._path = observation[keys.PATH][0].numpy().copy()
        self._append(observation)

    def add(self, action: Tensor, observation: TensorDictBase) -> None:
        """Add a command ``[2]`` in m/s and rad/s and the step's observation, ``[N]``."""
        self._series[keys.ACTION].append(action.numpy().copy())
        self._append(observation)

    def frame(self) -> np.ndarray:
        """Return an image of the current step, ``[480, 480, 3]`` uint8.

        Raises:
            ResetNeeded: If no episode has begun.
        """
        if not self._series:
            raise ResetNeeded("render() without an episode: call reset() first")
        if self._scene is None:
            self._scene = LiveScene()
        return self._scene.draw(self._recording())

    def _append(self, observation: TensorDictBase) -> None:
        state = self._env.simulator.state()
        pedestrians = state.pedestrians[0]
        self._series[keys.POSE].append(state.pose[0].numpy().copy())
        self._series[keys.RANGES].append(observation.get(keys.RANGES)[0].numpy().copy())
        self._series[keys.PEDESTRIAN_BOXES].append(pedestrians.numpy().copy())
        self._outcome = Outcome(int(observation[keys.OUTCOME][0]))

    def _recording(self) -> Recording:
        series = {name: np.array(rows) for name, rows in self._series.items()}
        series[keys.ACTION] = series[keys.ACTION].reshape(
            -1, self._env.simulator.robot.command_size
        )
        scenario = Scenario(
            suite="navrl/Navigation-v0",
            seed=0,
            index=0,
            kind="other",
            boxes=self._env.simulator.walls(0).numpy(),
            start=series[keys.POSE][0],
            goal=self._path[-1],
            path=self._path,
            pedestrians=(),
            noise_seed=0,
        )
        outcome = self._outcome.name.lower()
        return Recording.of_episode(scenario, outcome, self._env, reward_terms={}, **series)
