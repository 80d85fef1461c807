"""Spaces, arrays and info of the gymnasium environments, for one or several worlds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, cast

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from tensordict import TensorDictBase
from torchrl.data import TensorSpec
from torchrl.data.tensor_specs import ContinuousBox
from torchrl.envs import EnvBase, TransformedEnv

from navrl import keys
from navrl.envs.navigation import NavigationEnv
from navrl.envs.outcome import Outcome
from navrl.worlds import Scenario

RAW = (keys.RANGES, keys.POSE, keys.PATH)
"""Keys of the raw observation."""

FindEpisode = Callable[[str, int], Scenario]
"""Map the name of a suite and an index to the scenario of that episode."""


class Renderer(Protocol):
    """Interface of renderers, so that this layer does not import the drawing code."""

    def start(self, observation: TensorDictBase) -> None:
        """Record the observation of a reset, ``[N]``."""

    def add(self, observation: TensorDictBase) -> None:
        """Record the observation of a step, ``[N]``, with the driven ``command``."""

    def frame(self) -> np.ndarray:
        """Return an image of the current step, ``[H, W, 3]`` uint8, of constant size."""
        ...


class Interface:
    """Spaces of one world of an environment, and the values of all its worlds as NumPy arrays.

    Args:
        env: Environment of N worlds on the CPU, raw or with transforms.
        observed: Keys of the observation.

    Raises:
        ValueError: If the environment is on another device, or does not observe a key.
    """

    def __init__(self, env: EnvBase, observed: Sequence[str]) -> None:
        """Check the keys and make the spaces."""
        if env.device is None or env.device.type != "cpu":
            raise ValueError(f"env.device={env.device}: must be cpu, as for NumPy arrays")
        self._observed, specs = tuple(observed), env.observation_spec
        unknown = sorted(set(observed) - {str(key) for key in specs})
        if unknown:
            raise ValueError(
                f"observed={unknown}: must be some of {sorted(map(str, specs.keys()))}"
            )
        self.observation = spaces.Dict({key: _space(specs[key]) for key in observed})
        limits = cast(ContinuousBox, env.action_spec.space)
        self.action = spaces.Box(limits.low[0].numpy(), limits.high[0].numpy(), dtype=np.float32)

    def observations(self, tensordict: TensorDictBase) -> dict[str, np.ndarray]:
        """Return copies ``[N, ...]`` of the observed values."""
        values = {key: tensordict.get(key).numpy() for key in self._observed}
        return {key: value.astype(self.observation[key].dtype) for key, value in values.items()}

    @staticmethod
    def info(tensordict: TensorDictBase) -> dict[str, np.ndarray]:
        """Return the info ``[N]`` of a reset or step, see :class:`GymnasiumNavigation`."""
        outcome = tensordict.get(keys.OUTCOME).reshape(-1).numpy().copy()
        terms = tensordict.get(keys.REWARD_TERMS).items()
        return {
            "outcome": outcome,
            "is_success": outcome == Outcome.SUCCESS,
            **{f"reward_{name}": value.reshape(-1).float().numpy().copy() for name, value in terms},
        }


def navigation_env(env: EnvBase) -> NavigationEnv:
    """Return the navigation environment below the transforms, if there are any."""
    base = env.base_env if isinstance(env, TransformedEnv) else env
    assert isinstance(base, NavigationEnv)
    return base


def frame_rate(env: NavigationEnv) -> int:
    """Return the frames per second at which one frame per step is real time."""
    return round(1 / env.simulator.time_step_s)


def render_modes(renderers: Sequence[Renderer]) -> str | None:
    """Return the render mode of an environment with these renderers."""
    return "rgb_array" if renderers else None


def frames(renderers: Sequence[Renderer]) -> tuple[np.ndarray, ...] | None:
    """Return a frame of each world; ``None`` with a warning without renderers."""
    if renderers:
        return tuple(renderer.frame() for renderer in renderers)
    gymnasium.logger.warn('render() without render_mode="rgb_array" returns None')
    return None


def chosen_episodes(
    options: Mapping[str, Any] | None, find_episode: FindEpisode | None, count: int
) -> list[Scenario] | None:
    """Return the episodes that the options of a reset choose; ``None`` for episodes at random.

    Args:
        options: ``None``, empty, or ``suite`` and ``index``, an integer or one for each world.
        find_episode: Source of the episodes.
        count: Number of worlds.

    Raises:
        ValueError: If an option is unknown, missing or out of range.
    """
    if not options:
        return None
    if set(options) != {"suite", "index"} or find_episode is None:
        raise ValueError(
            f"options={dict(options)}: must be None, empty, or have suite and index, as in "
            '{"suite": "table1", "index": 3}'
        )
    indices = np.asarray(options["index"])
    if indices.dtype.kind not in "iu" or indices.shape not in ((), (count,)):
        wanted = (
            "an integer" if count == 1 else f"an integer or {count} of them, one for each world"
        )
        raise ValueError(f"options.index={options['index']!r}: must be {wanted}")
    return [find_episode(options["suite"], int(k)) for k in np.broadcast_to(indices, count)]


def _space(spec: TensorSpec) -> spaces.Space:
    """Return the space of one world from the spec ``[N, ...]`` of all."""
    if spec.dtype == torch.bool:
        return spaces.MultiBinary(tuple(spec.shape[1:]))
    low, high = -np.inf, np.inf
    if isinstance(spec.space, ContinuousBox):
        low, high = spec.space.low[0].numpy(), spec.space.high[0].numpy()
    return spaces.Box(low, high, tuple(spec.shape[1:]), np.float32)
