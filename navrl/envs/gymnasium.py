"""Gymnasium environment of the navigation task: one world, NumPy arrays, scalar rewards."""

from __future__ import annotations

from typing import Any, Protocol

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.envs.navigation import NavigationEnv
from navrl.envs.outcome import Outcome

OBSERVED = (keys.RANGES, keys.POSE, keys.PATH)


class Renderer(Protocol):
    """Interface of renderers, so that this layer does not import the drawing code."""

    def start(self, observation: TensorDictBase) -> None:
        """Record the observation of a reset, ``[1]``."""

    def add(self, action: Tensor, observation: TensorDictBase) -> None:
        """Record a command ``[2]`` in m/s and rad/s and the step's observation, ``[1]``."""

    def frame(self) -> np.ndarray:
        """Return an image of the current step, ``[H, W, 3]`` uint8, of constant size."""
        ...


class GymnasiumNavigation(gymnasium.Env):
    """Adapt a :class:`NavigationEnv` of one world to gymnasium's interface.

    TorchRL's own ``register_gym`` returns arrays of shape (1,) for the reward and the end flags and
    does not pass gymnasium's ``check_env``; hence this adapter.

    **Observation**: ``ranges`` (beams,) m, ``pose`` (3,) world, ``path`` (P, 2) m world, float32.
    **Action**: (v, w) in m/s and rad/s. **Info**, after each reset and step:

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
        env: Environment of one world on the CPU.
        renderer: Draws the frames of ``render_mode="rgb_array"``; ``None`` is ``render_mode=None``.

    Raises:
        ValueError: If the environment has another number of worlds or is on another device.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012 -- as in gymnasium

    def __init__(self, env: NavigationEnv, renderer: Renderer | None = None) -> None:
        if env.batch_size != torch.Size([1]):
            raise ValueError(f"env.batch_size={list(env.batch_size)}: must be [1], one world")
        if env.device.type != "cpu":
            raise ValueError(f"env.device={env.device}: must be cpu, as for NumPy arrays")
        self._env, self._renderer = env, renderer
        self._is_running = False
        self.render_mode = None if renderer is None else "rgb_array"
        self.metadata = {**self.metadata, "render_fps": round(1 / env.simulator.time_step_s)}
        beams, limit = env.simulator.lidar.num_beams, env.simulator.lidar.max_range
        points = env.observation_spec[keys.PATH].shape[1]
        self.observation_space = spaces.Dict(
            {
                keys.RANGES: spaces.Box(0.0, limit, (beams,), np.float32),
                keys.POSE: spaces.Box(-np.inf, np.inf, (3,), np.float32),
                keys.PATH: spaces.Box(-np.inf, np.inf, (points, 2), np.float32),
            }
        )
        low, high = env.simulator.robot.bounds(env.device)
        self.action_space = spaces.Box(low.numpy(), high.numpy(), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Determines this episode and all later ones; ``None`` continues the generator.
            options: None supported; must be ``None`` or empty.

        Returns:
            Observation and info, see the class.

        Raises:
            ValueError: If an option is given.
        """
        if options:
            raise ValueError(f"options={options}: must be None or empty")
        super().reset(seed=seed)
        if seed is not None:
            self._env.set_seed(seed)
        observed = self._env.reset()
        self._is_running = True
        if self._renderer is not None:
            self._renderer.start(observed)
        return self._split(observed)

    def step(
        self, action: np.ndarray
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one time step.

        Args:
            action: ``(2,)`` (v, w) in m/s and rad/s, clipped to the robot's limits.

        Returns:
            Observation, reward, terminated, truncated and info, see the class.

        Raises:
            ValueError: If the action has another shape or is not finite.
            ResetNeeded: If the episode has ended or none has begun.
        """
        if not self._is_running:
            raise ResetNeeded("step() without a running episode: call reset() first")
        command = torch.as_tensor(np.asarray(action, dtype=np.float32))
        if command.shape != (2,):
            raise ValueError(f"action.shape={tuple(command.shape)}: must be (2,)")
        stepped = self._env.step(TensorDict({keys.ACTION: command[None]}, [1]))["next"]
        terminated, truncated = bool(stepped["terminated"]), bool(stepped["truncated"])
        self._is_running = not (terminated or truncated)
        if self._renderer is not None:
            self._renderer.add(command, stepped)
        observation, info = self._split(stepped)
        return observation, float(stepped["reward"]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """Return an image of the current step ``[H, W, 3]`` uint8; ``None`` without render_mode.

        Raises:
            ResetNeeded: If no episode has begun.
        """
        if self._renderer is None:
            gymnasium.logger.warn('render() without render_mode="rgb_array" returns None')
            return None
        return self._renderer.frame()

    def close(self) -> None:
        """Release the simulator."""
        if not self._env.is_closed:
            self._env.close()

    @staticmethod
    def _split(tensordict: TensorDictBase) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        observation = {key: tensordict.get(key)[0].numpy().copy() for key in OBSERVED}
        outcome = np.int64(tensordict[keys.OUTCOME].item())
        # An array, since gymnasium's vector environments stack NumPy's scalar bool as objects.
        info: dict[str, Any] = {
            "outcome": outcome,
            "is_success": np.array(outcome == Outcome.SUCCESS),
        }
        terms = tensordict.get(keys.REWARD_TERMS).items()
        info.update({f"reward_{name}": np.float32(value.item()) for name, value in terms})
        return observation, info
