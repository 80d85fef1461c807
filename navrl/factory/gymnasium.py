"""Construction of the gymnasium environments from Hydra overrides."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv

from navrl import keys
from navrl.config import compose, did_you_mean, instantiate, options
from navrl.envs import NavigationEnv, Outcome
from navrl.envs.gymnasium import GymnasiumNavigation
from navrl.envs.gymnasium_spaces import RAW
from navrl.envs.gymnasium_vector import GymnasiumVectorNavigation
from navrl.evaluation.recording import Recording
from navrl.factory.environment import make_env, make_navigation_env, make_pool
from navrl.factory.overrides import check_environment
from navrl.factory.training import observation_shapes
from navrl.transforms import compose as compose_transforms
from navrl.viz.live import LiveScene
from navrl.worlds import Scenario, Suite


def make_gymnasium_env(
    overrides: Sequence[str] = (),
    render_mode: str | None = None,
    observation: str = "raw",
    action: str = "physical",
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
        observation: ``"raw"``: ranges, pose and path; ``"transformed"``: what the network of the
            configuration reads.
        action: ``"physical"``: (v, w) in m/s and rad/s; ``"normalized"``: the same in [-1, 1], or
            what the transforms make of it.

    Returns:
        One world.

    Raises:
        ValueError: If an override would have no effect, or a value is not allowed.
    """
    made = _make(1, overrides, render_mode, observation, action)
    renderer = EpisodeRenderer(made.base) if render_mode else None
    return GymnasiumNavigation(made.env, renderer, made.observed, find_episode)


def make_gymnasium_vector_env(
    num_envs: int = 1,
    overrides: Sequence[str] = (),
    render_mode: str | None = None,
    observation: str = "raw",
    action: str = "physical",
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
) -> GymnasiumVectorNavigation:
    """Build the vector environment behind ``gymnasium.make_vec("navrl/Navigation-v0", N)``.

    All worlds are rows of one simulation, so none has a process.

    Args:
        num_envs: Number of worlds.
        overrides: See :func:`make_gymnasium_env`, as ``render_mode``, ``observation``, ``action``.
        render_mode: ``"rgb_array"`` draws every world.
        observation: ``"raw"`` or ``"transformed"``.
        action: ``"physical"`` or ``"normalized"``.
        autoreset_mode: See :class:`navrl.envs.gymnasium_vector.GymnasiumVectorNavigation`.

    Raises:
        ValueError: If an override would have no effect, or a value is not allowed.
    """
    if num_envs < 1:
        raise ValueError(f"num_envs={num_envs}: must be >= 1")
    made = _make(num_envs, overrides, render_mode, observation, action)
    worlds = range(num_envs if render_mode else 0)
    renderers = [EpisodeRenderer(made.base, world) for world in worlds]
    return GymnasiumVectorNavigation(
        made.env, renderers, made.observed, find_episode, autoreset_mode
    )


for _make_one in (make_gymnasium_env, make_gymnasium_vector_env):
    vars(_make_one)["metadata"] = GymnasiumNavigation.metadata  # read by gymnasium.make


def find_episode(suite: str, index: int) -> Scenario:
    """Return an episode of a suite of ``conf/suite``, checked against the frozen one.

    Raises:
        ValueError: If there is no such suite or episode.
    """
    return _suite(suite).scenarios([index])[0]


@lru_cache(maxsize=4)
def _suite(name: str) -> Suite:
    known = options("suite")
    if name not in known:
        near = did_you_mean(str(name), known)
        raise ValueError(f"options.suite={name!r}: must be one of {', '.join(known)}{near}")
    return instantiate(compose("evaluate", [f"suite={name}"]).suite)


class _Made(NamedTuple):
    """An environment, the one below its transforms, and the keys that it observes."""

    env: EnvBase
    base: NavigationEnv
    observed: Sequence[str]


def _make(
    num_worlds: int,
    overrides: Sequence[str],
    render_mode: str | None,
    observation: str,
    action: str,
) -> _Made:
    modes = GymnasiumNavigation.metadata["render_modes"]
    _check_choice("render_mode", render_mode, (None, *modes))
    _check_choice("observation", observation, ("raw", "transformed"))
    _check_choice("action", action, ("physical", "normalized"))
    is_raw, is_normalized = observation == "raw", action == "normalized"
    check_environment(overrides, is_transformed=not is_raw)
    cfg = compose("train", list(overrides))
    cfg.num_worlds = num_worlds
    base = make_navigation_env(cfg, num_worlds, make_pool(cfg), seed=None)
    if is_raw and not is_normalized:
        return _Made(base, base, RAW)
    transforms = compose_transforms() if is_raw else instantiate(cfg.transforms)
    env = make_env(base, transforms, is_normalized)
    return _Made(env, base, RAW if is_raw else _network_inputs(cfg, env))


def _network_inputs(cfg: DictConfig, env: TransformedEnv) -> list[str]:
    """Return the keys that the networks of the configuration read."""
    return list(instantiate(cfg.network.encoder)(shapes=observation_shapes(env)).in_keys)


def _check_choice(name: str, value: str | None, allowed: Sequence[str | None]) -> None:
    if value not in allowed:
        known = ", ".join(map(repr, allowed))
        raise ValueError(f"{name}={value!r}: must be one of {known}")


class EpisodeRenderer:
    """Renderer of the running episode by :mod:`navrl.viz`.

    Args:
        env: Environment.
        world: Index of the world that is drawn.
    """

    def __init__(self, env: NavigationEnv, world: int = 0) -> None:
        self._env, self._world = env, world
        self._scene: LiveScene | None = None
        self._outcome = Outcome.RUNNING
        self._series: dict[str, list[np.ndarray]] = {}

    def start(self, observation: TensorDictBase) -> None:
        """Start with the observation of a reset, ``[N]``."""
        self._series = {
            name: [] for name in (keys.POSE, keys.RANGES, keys.PEDESTRIAN_BOXES, keys.ACTION)
        }
        self._path = observation[keys.PATH][self._world].numpy().copy()
        self._append(observation)

    def add(self, observation: TensorDictBase) -> None:
        """Add the observation of a step, ``[N]``, and its command in m/s and rad/s."""
        self._series[keys.ACTION].append(observation[keys.COMMAND][self._world].numpy().copy())
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
        pedestrians = state.pedestrians[self._world]
        self._series[keys.POSE].append(state.pose[self._world].numpy().copy())
        self._series[keys.RANGES].append(observation.get(keys.RANGES)[self._world].numpy().copy())
        self._series[keys.PEDESTRIAN_BOXES].append(pedestrians.numpy().copy())
        self._outcome = Outcome(int(observation[keys.OUTCOME][self._world]))

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
            boxes=self._env.simulator.walls(self._world).numpy(),
            start=series[keys.POSE][0],
            goal=self._path[-1],
            path=self._path,
            pedestrians=(),
            noise_seed=0,
        )
        outcome = self._outcome.name.lower()
        return Recording.of_episode(scenario, outcome, self._env, reward_terms={}, **series)
