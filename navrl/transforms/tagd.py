"""Temporal accumulation group descriptors (TAGD) as TensorDict keys."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor
from torchrl.data import TensorSpec

from navrl import keys
from navrl.ops.grouping import EmptyNow, EmptyPrevious, EmptyScans, check_grouping, tagd
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec, real_spec


class TAGD(ObservationMap):
    """Describe the position of the nearest obstacle in each direction at t-1 and t.

    Args:
        num_groups: Number of rays N_c.
        group_radius: Distance threshold d_thresh to the group center, m. It should exceed the
            displacement of the fastest obstacle in one step.
        max_range: Range d_max of the group center on a ray without a return, m.
        empty_now: ``"center"`` or ``"zeros"``, value of ``c_t`` for an empty group.
        empty_previous: ``"current"``, ``"center"`` or ``"zeros"``, value of ``c_{t-1}`` for an
            empty group.
        empty_scans: ``"groups"`` or ``"zeros"``, rule for scans without any return.
        in_keys: Points ``[*B, N, 2]`` m and returns ``[*B, N]`` bool of scan t; points of scan
            t-1 *in frame t* ``[*B, M, 2]`` m and their returns ``[*B, M]`` bool.
        out_keys: Descriptors ``[*B, N_c, 4]`` m, ``(c_{t-1}, c_t)`` in frame t, and validity of
            their halves ``[*B, N_c, 2]`` bool.

    Raises:
        ValueError: If an argument is invalid; the message names it.

    Example:
        >>> import torch
        >>> now, is_return = torch.tensor([[[1.0, 0.0]]]), torch.tensor([[True]])
        >>> descriptors, valid = TAGD(num_groups=4)(
        ...     points=now, returns=is_return,
        ...     points_aligned=now + torch.tensor([0.1, 0.0]), returns_previous=is_return,
        ... )
        >>> descriptors[0, 0], valid[0, 0]
        (tensor([1.1000, 0.0000, 1.0000, 0.0000]), tensor([True, True]))

    Reference:
        Paper Sec. IV-A, Algorithm 1; see :func:`navrl.ops.grouping.tagd` for the interpretation.
    """

    INPUTS = ("points", "returns", "aligned previous points", "previous returns")
    OUTPUTS = ("descriptors", "valid")

    def __init__(
        self,
        num_groups: int = 30,
        group_radius: float = 0.25,
        max_range: float = 3.5,
        empty_now: EmptyNow = "center",
        empty_previous: EmptyPrevious = "current",
        empty_scans: EmptyScans = "groups",
        in_keys: Keys = (
            keys.POINTS,
            keys.RETURNS,
            keys.ALIGNED_POINTS,
            keys.PREVIOUS_RETURNS,
        ),
        out_keys: Keys = (keys.TAGD, keys.TAGD_VALID),
    ) -> None:
        super().__init__(in_keys, out_keys)
        self.settings = (
            num_groups,
            group_radius,
            max_range,
            empty_now,
            empty_previous,
            empty_scans,
        )
        check_grouping(*self.settings)
        self.num_groups = num_groups

    def map_values(
        self, points: Tensor, returns: Tensor, previous_points: Tensor, previous_returns: Tensor
    ) -> Sequence[Tensor]:
        """Compute the descriptors; see :func:`navrl.ops.grouping.tagd`."""
        return tagd(points, returns, previous_points, previous_returns, *self.settings)

    def map_specs(
        self,
        points: TensorSpec,
        returns: TensorSpec,
        previous_points: TensorSpec,
        previous_returns: TensorSpec,
    ) -> Sequence[TensorSpec]:
        """Return the specs of descriptors and validity."""
        shape = (*points.shape[:-2], self.num_groups)
        return real_spec(points, *shape, 4), flag_spec(points, *shape, 2)
