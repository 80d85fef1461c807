"""Time since a robot last made progress on its path."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from navrl import keys
from navrl.checks import check_positive
from navrl.transforms.observation_map import (
    Keys,
    cloned,
    nested_keys,
    observed_specs,
    read,
    read_spec,
    real_spec,
)
from navrl.transforms.stateful import StatefulTransform


class StallTimer(StatefulTransform):
    """Measure the time since the robot last made progress on its path.

    The largest progress and the time since it was reached are passed from step to step in the
    TensorDict. Progress counts if it exceeds the largest one by ``min_progress``; once the robot
    has stalled for ``patience``, only if it does by ``free_progress``, so that a robot that was
    freed is not stuck again at once.

    Args:
        time_step: Time between two steps, s.
        patience: Time without progress after which the robot has stalled, s.
        min_progress: Least progress that restarts the time, m.
        free_progress: The same for a robot that has stalled, m.
        in_keys: Progress on the path ``[*B, 1]`` m, e.g. of :class:`navrl.transforms.Waypoints`.
        out_keys: ``[*B, 2]``, largest progress m and time since it was reached s.

    Raises:
        ValueError: If an argument is not positive, a number of keys is wrong, or later if the
            environment lacks a key.

    Example:
        >>> timer = StallTimer(time_step=0.2)
        >>> timer(path_progress=torch.tensor([[1.5]]))
        tensor([[1.5000, 0.0000]])

    Reference:
        Not in the paper. Navigation stacks recover likewise, e.g. Nav2 by its progress checker.
    """

    def __init__(
        self,
        time_step: float = 0.2,
        patience: float = 2.0,
        min_progress: float = 0.05,
        free_progress: float = 0.5,
        in_keys: Keys = (keys.PATH_PROGRESS,),
        out_keys: Keys = (keys.STALL,),
    ) -> None:
        super().__init__(in_keys=nested_keys(in_keys), out_keys=nested_keys(out_keys))
        if len(self.in_keys) != 1 or len(self.out_keys) != 1:
            raise ValueError(
                f"StallTimer: in_keys={self.in_keys}, out_keys={self.out_keys}: must be one each "
                "(progress; stall)"
            )
        check_positive(
            time_step=time_step,
            patience=patience,
            min_progress=min_progress,
            free_progress=free_progress,
        )
        self.time_step, self.patience = time_step, patience
        self.min_progress, self.free_progress = min_progress, free_progress

    def restart(self, tensordict: TensorDictBase, progress: Tensor) -> None:
        """Convert the largest progress to another path; its lead over the progress is the same.

        A path that begins at a robot that has backed up hides the way back: then that way counts.

        Args:
            tensordict: ``[*B]``, root of the next step, with the progress on the path before.
            progress: ``[*B, 1]`` m, arc length on the new path at which the search starts.
        """
        best, since = read(self, tensordict, self.out_keys[0]).split(1, dim=-1)
        shift = progress - read(self, tensordict, self.in_keys[0])
        tensordict.set(self.out_keys[0], torch.cat([best + shift, since], dim=-1))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        best, since = read(self, tensordict, self.out_keys[0]).unbind(-1)
        progress = read(self, next_tensordict, self.in_keys[0]).squeeze(-1)
        stalled = has_stalled(since, self.patience, self.time_step)
        needed = torch.where(stalled, self.free_progress, self.min_progress)
        grown = progress >= best + needed
        stall = [
            torch.where(grown, progress, best),
            torch.where(grown, 0.0, since + self.time_step),
        ]
        return next_tensordict.set(self.out_keys[0], torch.stack(stall, dim=-1))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Start the time, as after a reset."""
        progress = read(self, next_tensordict, self.in_keys[0])
        start = torch.cat([progress, torch.zeros_like(progress)], dim=-1)
        return next_tensordict.set(self.out_keys[0], start)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the spec of the stall to those of the environment."""
        observation_spec = cloned(observation_spec)
        observation_spec[self.out_keys[0]] = self._spec(observation_spec)
        return observation_spec

    def transform_input_spec(self, input_spec: TensorSpec) -> Composite:
        """Add the stall to the state spec, because a step reads it."""
        input_spec = cloned(input_spec)
        input_spec["full_state_spec"][self.out_keys[0]] = self._spec(observed_specs(self))
        return input_spec

    def _spec(self, specs: Composite) -> TensorSpec:
        progress = read_spec(self, specs, self.in_keys[0])
        return real_spec(progress, *progress.shape[:-1], 2)


def has_stalled(since: Tensor, patience: float, time_step: float) -> Tensor:
    """Return whether the time without progress has reached ``patience``, within half a step."""
    return since >= patience - 0.5 * time_step
