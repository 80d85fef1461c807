"""Transformed environment whose partial resets retain the present values."""

from __future__ import annotations

from typing import cast

from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl.envs.navigation import NavigationEnv


class TransformedNavigationEnv(TransformedEnv):
    """``TransformedEnv`` that passes present values to its transforms at a partial reset.

    TorchRL's own hands them the key ``_reset`` and the state only. Then a transform that compares
    two times cannot return the present values of the rows that are not reset, and statistics of
    whole batches behind it (VecNorm) would be biased.
    """

    _present: TensorDictBase | None = None  # during a call of reset() only

    def reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        """Reset as ``TransformedEnv`` does; see there for the arguments."""
        self._present = tensordict
        try:
            return super().reset(tensordict, **kwargs)
        finally:
            self._present = None

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        if self._present is None:
            return super()._reset(tensordict, **kwargs)
        rows = self._present.select(*self.reset_keys, strict=False)
        fresh = self.base_env._reset(rows, **kwargs)
        self.base_env._complete_done(self.base_env.full_done_spec, fresh)
        return self.transform._reset(self._present.copy(), fresh)


def base_env(env: TransformedEnv) -> NavigationEnv:
    """Return the navigation environment below the transforms."""
    return cast(NavigationEnv, env.base_env)
