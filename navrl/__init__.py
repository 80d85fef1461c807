"""Lidar navigation among pedestrians, learned with spatiotemporal attention.

Importing the package registers ``navrl/Navigation-v0`` with gymnasium and loads nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import gymnasium

if TYPE_CHECKING:
    from torchrl.envs import TransformedEnv

__version__ = "0.1.0"

gymnasium.register(
    id="navrl/Navigation-v0",
    entry_point="navrl.factory:make_gymnasium_env",
    vector_entry_point="navrl.factory:make_gymnasium_vector_env",
)


def make(
    name_or_overrides: str | Sequence[str] = "quick", num_worlds: int = 64, seed: int | None = 0
) -> TransformedEnv:
    """Build the batched TorchRL environment of the task, with its transforms.

    Actions are ``action [N, 2]`` in [-1, 1]; observations have the raw keys and those of the
    transforms, see ``docs/pipeline.md``. TorchRL's losses, collectors and transforms take it as
    it is.

    Args:
        name_or_overrides: Name of an experiment in ``conf/experiment``, whose worlds, lidar, robot,
            rewards and transforms are used; or Hydra overrides of ``conf/train.yaml``, e.g.
            ``["scenario=office", "transforms=navrl_best"]``.
        num_worlds: Number of worlds N, simulated as one batch.
        seed: Determines all episodes; ``None`` draws one, so that copies differ.

    Returns:
        Environment of batch size ``[N]``.

    Raises:
        ValueError: If there is no such experiment, or an override has no effect on an environment
            or a value that is not allowed.

    Example:
        >>> import navrl
        >>> env = navrl.make(["scenario=corridor", "pool_size=4"], num_worlds=2)
        >>> env.rollout(3, break_when_any_done=False)["spatial"].shape
        torch.Size([2, 3, 180, 2])
    """
    from navrl.factory import make_batched_env  # imports torch

    return make_batched_env(name_or_overrides, num_worlds, seed)
