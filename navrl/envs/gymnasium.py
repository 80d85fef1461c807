"""The navigation task as a plain gymnasium environment: one world, NumPy, Python scalars."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from tensordict import TensorDict, TensorDictBase

from navrl import keys
from navrl.envs.navigation import NavigationEnv
from navrl.envs.outcome import Outcome

OBSERVED = (keys.RANGES, keys.POSE, keys.PATH)


class GymnasiumNavigation(gymnasium.Env):
    """Adapt a :class:`NavigationEnv` of one world to gymnasium's interface.

    TorchRL's own ``register_gym`` returns arrays of shape (1,) for the reward and the end flags and
    does not pass gymnasium's ``check_env``; hence this thin adapter.

    **Observation**: ``ranges`` (beams,) m, ``pose`` (3,) world, ``path`` (P, 2) m world, float32.
    **Action**: (v, w) in m/s and rad/s. **Info**: ``outcome`` by name, and each reward term.

    Args:
        env: Environment of one world.

    Raises:
        ValueError: If the environment has another number of worlds.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 -- gymnasium's own convention

    def __init__(self, env: NavigationEnv) -> None:
        if env.batch_size != torch.Size([1]):
            raise ValueError(f"env: need one world, got batch size {list(env.batch_size)}")
        self._env = env
        beams, limit = env.simulator.lidar.num_beams, env.simulator.lidar.max_range
        points = env.observation_spec[keys.PATH].shape[1]
        self.observation_space = spaces.Dict(
            {
                keys.RANGES: spaces.Box(0.0, limit, (beams,), np.float32),
                keys.POSE: spaces.Box(-np.inf, np.inf, (3,), np.float32),
                keys.PATH: spaces.Box(-np.inf, np.inf, (points, 2), np.float32),
            }
        )
        limits = env.action_spec_unbatched.space
        self.action_space = spaces.Box(limits.low.numpy(), limits.high.numpy(), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode; a seed fixes this one and all that follow."""
        super().reset(seed=seed)
        if seed is not None:
            self._env.set_seed(seed)
        return self._split(self._env.reset())

    def step(
        self, action: np.ndarray
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one time step."""
        command = torch.as_tensor(np.asarray(action, dtype=np.float32)).reshape(1, 2)
        stepped = self._env.step(TensorDict({keys.ACTION: command}, [1]))["next"]
        observation, info = self._split(stepped)
        return (
            observation,
            float(stepped["reward"]),
            bool(stepped["terminated"]),
            bool(stepped["truncated"]),
            info,
        )

    def close(self) -> None:
        """Release the simulator."""
        if not self._env.is_closed:
            self._env.close()

    @staticmethod
    def _split(tensordict: TensorDictBase) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        observation = {key: tensordict[key][0].numpy().copy() for key in OBSERVED}
        info: dict[str, Any] = {"outcome": Outcome(int(tensordict[keys.OUTCOME])).name.lower()}
        terms = tensordict[keys.REWARD_TERMS].items()
        info.update({f"reward_{name}": float(value) for name, value in terms})
        return observation, info
