"""Base class of transforms whose outputs depend on those of the step before."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import dispatch
from torchrl.envs import Transform

from navrl.transforms.observation_map import map_reset_rows, restore_history


class StatefulTransform(Transform):
    """Base class of transforms that carry their outputs from step to step in the TensorDict.

    A subclass defines ``_call``, the outputs of a scan without a past, and ``_step``, which reads
    those of the root. No state is stored in the transform, so partial resets, interleaved streams,
    planning and replay each have their own.

    Raises:
        ValueError: If the root of stored transitions lacks an output.
    """

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return map_reset_rows(self, tensordict, tensordict_reset)

    @dispatch(source="in_keys", dest="out_keys", auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Restore the outputs of stored data.

        Under ``"next"`` they are computed from the root, also at the end of an episode. At the
        root, stored outputs are retained. Data without them and without ``"next"`` is treated as
        starts of episodes.

        Raises:
            ValueError: If the root of a transition lacks an output.
        """
        return restore_history(self, tensordict)
