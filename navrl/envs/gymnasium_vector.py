"""Gymnasium vector environment over one batch of worlds, without a process for each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from navrl import keys
from navrl.envs.gymnasium_spaces import (
    RAW,
    FindEpisode,
    Interface,
    Renderer,
    chosen_episodes,
    frame_rate,
    frames,
    navigation_env,
    render_modes,
)
from navrl.worlds import ScenarioBatch


class GymnasiumVectorNavigation(VectorEnv):
    """Adapt an environment of N worlds to gymnasium's interface of vector environments.

    Results are those of :class:`gymnasium.vector.SyncVectorEnv` over N environments of
    :class:`navrl.envs.gymnasium.GymnasiumNavigation`: each world has its own generator, so that
    ``reset(seed=s)`` gives world i the episodes of a single environment with the seed s + i.

    Args:
        env: Environment of N worlds on the CPU, raw or with transforms.
        renderers: One per world for ``render_mode="rgb_array"``; empty is ``render_mode=None``.
        observed: Keys of the observation.
        find_episode: Source of the episodes of ``reset(options={"suite": ..., "index": ...})``.
        autoreset_mode: What happens to a world whose episode has ended: ``NEXT_STEP`` resets it in
            the next step, whose action it ignores, ``SAME_STEP`` at once, with the last observation
            and info under ``final_obs`` and ``final_info``; ``DISABLED`` leaves it to the caller.

    Raises:
        ValueError: If the environment is on another device, draws no scenarios or does not observe
            a key, or if there is no such mode.

    Example:
        >>> import gymnasium, navrl
        >>> overrides = ["scenario=corridor", "pool_size=4"]
        >>> envs = gymnasium.make_vec("navrl/Navigation-v0", 3, overrides=overrides)
        >>> observation, info = envs.reset(seed=0)
        >>> observation["ranges"].shape
        (3, 1440)
    """

    def __init__(
        self,
        env: EnvBase,
        renderers: Sequence[Renderer] = (),
        observed: Sequence[str] = RAW,
        find_episode: FindEpisode | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Check the arguments and make the spaces."""
        modes = [mode.value for mode in AutoresetMode]
        if autoreset_mode not in (*AutoresetMode, *modes):
            raise ValueError(f"autoreset_mode={autoreset_mode!r}: must be one of {modes}")
        self._interface = Interface(env, observed)
        self._env, self._base = env, navigation_env(env)
        if self._base.scenarios is None:
            raise ValueError("env.scenarios=None: must be a pool, from which each world draws")
        self._pool, self._find_episode = self._base.scenarios, find_episode
        self._renderers = tuple(renderers)
        self.autoreset_mode = AutoresetMode(autoreset_mode)  # read by TorchRL
        self.num_envs = env.batch_size.numel()
        self._generators = [torch.Generator() for _ in range(self.num_envs)]
        for generator in self._generators:
            generator.seed()  # the operating system's entropy, so that copies differ
        self._carrier: TensorDictBase | None = None
        self._ended = np.zeros(self.num_envs, dtype=bool)
        self.render_mode = render_modes(self._renderers)
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": frame_rate(self._base),
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space = self._interface.observation
        self.single_action_space = self._interface.action
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode in every world, or in some.

        Args:
            seed: Of world 0, the others count up; or one for each world. ``None`` continues.
            options: ``reset_mask`` ``[N]`` bool starts an episode in these worlds only; ``suite``
                and ``index``, an integer or one for each world, choose the episodes.

        Returns:
            Observations ``[N, ...]`` and infos with their masks, as ``SyncVectorEnv`` has them.

        Raises:
            ValueError: If an option or the number of seeds is not allowed.
        """
        options = dict(options or {})
        mask = self._checked_mask(options.pop("reset_mask", np.ones(self.num_envs, dtype=bool)))
        chosen = chosen_episodes(options, self._find_episode, self.num_envs)
        self._seed(seed, mask)
        episodes = None
        if chosen is not None:
            episodes = ScenarioBatch.pack([chosen[world] for world in mask.nonzero()[0]])
        self._start(mask, episodes)
        return self._observations(), _masked(self._interface.info(self._carrier), mask)

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive all worlds for one time step.

        Args:
            actions: ``[N, C]``, as in ``action_space``; clipped to its limits.

        Returns:
            Observations, rewards ``[N]``, terminated ``[N]``, truncated ``[N]`` and infos.

        Raises:
            ValueError: If the actions have another shape or are not finite.
            ResetNeeded: If no episode has begun, or with ``DISABLED`` a world's has ended.
        """
        if self._carrier is None:
            raise ResetNeeded("step() without a running episode: call reset() first")
        if self.autoreset_mode == AutoresetMode.DISABLED and self._ended.any():
            worlds = self._ended.nonzero()[0].tolist()
            raise ResetNeeded(f"step() after the end in worlds {worlds}: reset them by reset_mask")
        result = self._env.step(self._carrier.set(keys.ACTION, self._commands(actions)))
        stepped, self._carrier = result["next"], step_mdp(result)
        for renderer in self._renderers:
            renderer.add(stepped)
        fresh = self._ended  # only of NEXT_STEP: reset in this step
        rewards, terminated, truncated = (
            np.where(fresh, 0, stepped[key].reshape(-1).numpy()).astype(kind)
            for key, kind in (("reward", np.float64), ("terminated", bool), ("truncated", bool))
        )
        self._ended = ended = terminated | truncated
        final: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            final, fresh = self._final(stepped, ended), ended
        if fresh.any():
            self._start(fresh)
            self._ended = ended & ~fresh
        every = np.ones(self.num_envs, dtype=bool)
        infos = {**final, **_masked(self._interface.info(self._carrier), every)}
        return self._observations(), rewards, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return an image ``[H, W, 3]`` uint8 of each world; ``None`` without render_mode."""
        return frames(self._renderers)

    def close_extras(self, **kwargs: Any) -> None:
        """Release the simulator."""
        if not self._env.is_closed:
            self._env.close()

    def _checked_mask(self, mask: np.ndarray) -> np.ndarray:
        mask = np.asarray(mask)
        if mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"options.reset_mask={mask}: must be a boolean array of shape ({self.num_envs},) "
                "with at least one true value"
            )
        if self._carrier is None and not mask.all():
            raise ResetNeeded("reset_mask without a running episode: reset all worlds first")
        return mask

    def _seed(self, seed: int | Sequence[int | None] | None, mask: np.ndarray) -> None:
        """Seed the generators of the worlds in ``mask``."""
        if seed is None:
            return
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(
                f"seed: must be one for each of {self.num_envs} worlds, got {len(seeds)}"
            )
        for generator, number, is_reset in zip(self._generators, seeds, mask, strict=True):
            if number is not None and is_reset:
                generator.manual_seed(number)

    def _start(self, mask: np.ndarray, episodes: ScenarioBatch | None = None) -> None:
        """Start an episode in the worlds of ``mask``.

        Args:
            mask: ``[N]`` bool.
            episodes: One per world in ``mask``, in order; drawn if ``None``.
        """
        if episodes is None:
            pool, drawing = self._pool, [self._generators[world] for world in mask.nonzero()[0]]
            episodes = _joined([pool.draw(generator, 1) for generator in drawing])
        rows = torch.from_numpy(mask.cumsum() - 1).clamp_min(0)  # others are not read
        self._base.set_scenarios(episodes[rows])
        carrier = TensorDict({}, [self.num_envs]) if self._carrier is None else self._carrier
        is_reset = torch.from_numpy(mask).unsqueeze(-1)
        whole = mask.all()
        self._carrier = self._env.reset(None if whole else carrier.set("_reset", is_reset))
        self._base.set_scenarios(None)
        self._ended = self._ended & ~mask
        for world, renderer in enumerate(self._renderers):
            if mask[world]:
                renderer.start(self._carrier)

    def _commands(self, actions: np.ndarray) -> Tensor:
        """Return the actions ``[N, C]``, zero in worlds that are reset in this step."""
        values = np.asarray(actions, dtype=np.float32)
        if values.shape != self.action_space.shape:
            raise ValueError(f"actions.shape={values.shape}: must be {self.action_space.shape}")
        return torch.from_numpy(np.where(self._ended[:, None], np.float32(0), values))

    def _observations(self) -> dict[str, np.ndarray]:
        assert self._carrier is not None  # an episode has begun
        return self._interface.observations(self._carrier)

    def _final(self, stepped: TensorDictBase, ended: np.ndarray) -> dict[str, Any]:
        """Return the last observations and infos of the worlds in ``ended``."""
        observations = self._interface.observations(stepped)
        final = np.full(self.num_envs, None, dtype=object)
        for world in ended.nonzero()[0]:
            final[world] = {key: value[world] for key, value in observations.items()}
        info = _masked(self._interface.info(stepped), ended)
        return {"final_obs": final, "_final_obs": ended, "final_info": info, "_final_info": ended}


def _masked(info: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
    """Return infos ``[N]`` with their masks, zero outside of ``mask``."""
    kept = {key: np.where(mask, value, np.zeros_like(value)) for key, value in info.items()}
    return {**kept, **{f"_{key}": mask.copy() for key in kept}}


def _joined(batches: Sequence[ScenarioBatch]) -> ScenarioBatch:
    """Join batches of the same pool."""
    tensors = [batch.tensors() for batch in batches]
    joined = {name: torch.cat([each[name] for each in tensors]) for name in tensors[0]}
    return ScenarioBatch.from_tensors(joined, batches[0].kinds)
