"""Gymnasium environment of the navigation task: one world, NumPy arrays, scalar rewards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from tensordict import TensorDict, TensorDictBase
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


class GymnasiumNavigation(gymnasium.Env):
    """Adapt an environment of one world to gymnasium's interface.

    TorchRL's own ``register_gym`` returns arrays of shape (1,) for the reward and the end flags and
    does not pass gymnasium's ``check_env``; hence this adapter.

    **Observation**: the observed keys as float32; of a raw environment ``ranges`` (beams,) m,
    ``pose`` (3,) world, ``path`` (P, 2) m world. **Action**: as the environment takes it; of a raw
    one (v, w) in m/s and rad/s. **Info**, after each reset and step:

    ===============  =======  ==================================================================
    key              dtype    meaning
    ===============  =======  ==================================================================
    outcome          int64    code of :class:`navrl.envs.Outcome`; its name is
                              ``Outcome(info["outcome"]).name``
    is_success       bool     the goal is reached in this step; an array of shape ()
    reward_TERM      float32  contribution of each term to the reward, weight included
    ===============  =======  ==================================================================

    All of them are NumPy values, because vector environments and TorchRL's info reader stack them.

    **Seeds**: ``reset(seed=...)`` determines this episode and all later ones. An environment
    without a seed draws one from the operating system, so that copies differ.

    **End**: a step after the end raises :class:`gymnasium.error.ResetNeeded`.

    Args:
        env: Environment of one world on the CPU, raw or with transforms.
        renderer: Draws the frames of ``render_mode="rgb_array"``; ``None`` is ``render_mode=None``.
        observed: Keys of the observation.
        find_episode: Source of the episodes of ``reset(options={"suite": ..., "index": ...})``.

    Raises:
        ValueError: If the environment has another number of worlds, is on another device, or does
            not observe a key.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012 -- as in gymnasium

    def __init__(
        self,
        env: EnvBase,
        renderer: Renderer | None = None,
        observed: Sequence[str] = RAW,
        find_episode: FindEpisode | None = None,
    ) -> None:
        if env.batch_size != torch.Size([1]):
            raise ValueError(f"env.batch_size={list(env.batch_size)}: must be [1], one world")
        self._interface = Interface(env, observed)
        self._env, self._base = env, navigation_env(env)
        self._renderers = () if renderer is None else (renderer,)
        self._find_episode = find_episode
        self._carrier: TensorDictBase = TensorDict({}, [1])
        self._is_running = False
        self.render_mode = render_modes(self._renderers)
        self.metadata = {**self.metadata, "render_fps": frame_rate(self._base)}
        self.observation_space, self.action_space = (
            self._interface.observation,
            self._interface.action,
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Determines this episode and all later ones; ``None`` continues the generator.
            options: ``{"suite": "table1", "index": 3}`` plays that episode of a suite; ``None``, or
                empty, draws one.

        Returns:
            Observation and info, see the class.

        Raises:
            ValueError: If an option is not allowed.
        """
        chosen = chosen_episodes(options, self._find_episode, 1)
        super().reset(seed=seed)
        if seed is not None:
            self._env.set_seed(seed)
        self._base.set_scenarios(None if chosen is None else ScenarioBatch.pack(chosen))
        self._carrier = self._env.reset()
        self._base.set_scenarios(None)
        self._is_running = True
        for renderer in self._renderers:
            renderer.start(self._carrier)
        return self._split(self._carrier)

    def step(
        self, action: np.ndarray
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one time step.

        Args:
            action: As in ``action_space``; clipped to its limits.

        Returns:
            Observation, reward, terminated, truncated and info, see the class.

        Raises:
            ValueError: If the action has another shape or is not finite.
            ResetNeeded: If the episode has ended or none has begun.
        """
        if not self._is_running:
            raise ResetNeeded("step() without a running episode: call reset() first")
        command = torch.as_tensor(np.asarray(action, dtype=np.float32))
        if command.shape != self.action_space.shape:
            raise ValueError(
                f"action.shape={tuple(command.shape)}: must be {self.action_space.shape}"
            )
        result = self._env.step(self._carrier.set(keys.ACTION, command[None]))
        stepped, self._carrier = result["next"], step_mdp(result)
        terminated, truncated = bool(stepped["terminated"]), bool(stepped["truncated"])
        self._is_running = not (terminated or truncated)
        for renderer in self._renderers:
            renderer.add(stepped)
        observation, info = self._split(stepped)
        return observation, float(stepped["reward"]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """Return an image of the current step ``[H, W, 3]`` uint8; ``None`` without render_mode.

        Raises:
            ResetNeeded: If no episode has begun.
        """
        images = frames(self._renderers)
        return None if images is None else images[0]

    def close(self) -> None:
        """Release the simulator."""
        if not self._env.is_closed:
            self._env.close()

    def _split(self, tensordict: TensorDictBase) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        observations = self._interface.observations(tensordict)
        info: dict[str, Any] = {
            key: value[0] for key, value in self._interface.info(tensordict).items()
        }
        # An array, since gymnasium's vector environments stack NumPy's scalar bool as objects.
        info["is_success"] = np.array(info["is_success"])
        return {key: value[0] for key, value in observations.items()}, info
