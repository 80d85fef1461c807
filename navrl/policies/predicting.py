"""Controllers around models of other libraries with a ``predict`` method."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from tensordict import TensorDictBase

from navrl import keys
from navrl.deprecation import input_key
from navrl.extras import install_hint
from navrl.policies.controller import Controller


class Predicting(Protocol):
    """Interface of models with gymnasium's spaces and the ``predict`` of stable-baselines3."""

    observation_space: Any
    action_space: Any

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[np.ndarray, object]:
        """Return actions ``[N, C]`` for N observations, and a state, which is ignored."""
        ...


class PredictingPolicy(Controller):
    """Controller around a model that was trained in a gymnasium environment.

    It is called with N worlds at a time and without noise. A model that carries a state from step
    to step (a recurrent one) needs a controller of its own.

    Args:
        model: Its ``observation_space`` is a ``Dict`` whose keys are observed in the environment,
            e.g. ``ranges``, ``pose`` and ``path``; its ``action_space`` is a ``Box`` of the
            robot's command, with the robot's limits.

    Raises:
        ValueError: If the spaces are of another kind or not finite.
    """

    def __init__(self, model: Predicting) -> None:
        super().__init__()
        spaces = getattr(model.observation_space, "spaces", None)
        if not isinstance(spaces, dict):
            raise ValueError(
                f"model.observation_space={type(model.observation_space).__name__}: must be a Dict "
                "of keys that the environment observes"
            )
        low, high = (np.asarray(getattr(model.action_space, k, np.nan)) for k in ("low", "high"))
        if low.ndim != 1 or not (np.isfinite(low) & np.isfinite(high) & (low < high)).all():
            raise ValueError(
                f"model.action_space={model.action_space}: must be a Box [C] with finite limits"
            )
        self.in_keys, self.out_keys = list(spaces), [keys.ACTION]
        self._model, self._spaces, self._low, self._high = model, spaces, low, high

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[N, C]``.

        Raises:
            ValueError: If an observation is missing or has another shape than the model's.
        """
        observed = {key: self._observed(tensordict, key) for key in self._spaces}
        command, _ = self._model.predict(observed, deterministic=True)
        action = 2.0 * (command.astype(np.float64) - self._low) / (self._high - self._low) - 1.0
        action = torch.from_numpy(action.clip(-1.0, 1.0).astype(np.float32))
        return tensordict.set(keys.ACTION, action.to(tensordict.device))

    def _observed(self, tensordict: TensorDictBase, key: str) -> np.ndarray:
        value = tensordict.get(input_key(key, tensordict.keys()), None)
        space = self._spaces[key]
        if value is None:
            known = sorted(map(str, tensordict.keys()))
            raise ValueError(f"{key}: is read by the model, but must be one of {', '.join(known)}")
        if tuple(value.shape[1:]) != tuple(space.shape):
            raise ValueError(
                f"{key}: must have the shape {list(space.shape)} of the model's training, "
                f"got {list(value.shape[1:])}"
            )
        return value.cpu().numpy().astype(space.dtype)


class StableBaselines3Policy(PredictingPolicy):
    """Play a model that stable-baselines3 saved as a zip.

    Loading a zip runs code that is stored in it (it has pickles): load only files that you trust.

    Args:
        file: Zip written by ``model.save``.
        trusted: Must be true: the user trusts the file.
        algorithm: Class in ``stable_baselines3`` that saved it, e.g. ``PPO``, ``SAC`` or ``TD3``.

    Raises:
        ImportError: If stable-baselines3 is not installed.
        ValueError: If the file is not trusted, there is no such algorithm or file, or the model
            does not fit.
    """

    requires = ("stable_baselines3",)

    def __init__(self, file: str | Path, algorithm: str = "PPO", trusted: bool = False) -> None:
        if trusted is not True:
            raise ValueError(
                f"file={file}: loading it runs code that is stored in it (pickles); if you trust "
                "the file, set trusted=true"
            )
        try:
            import stable_baselines3  # pyright: ignore[reportMissingImports] -- an extra
        except ImportError as error:
            hint = install_hint("clients")
            raise ImportError(f"policy: needs stable-baselines3 (MIT); {hint}") from error
        loader = getattr(stable_baselines3, algorithm, None)
        if loader is None or not hasattr(loader, "load"):
            raise ValueError(
                f"algorithm={algorithm}: must be a class of stable_baselines3, e.g. PPO"
            )
        if not Path(file).is_file():
            raise ValueError(f"file={file}: must be a zip that stable-baselines3 saved")
        super().__init__(loader.load(file, device="cpu"))
