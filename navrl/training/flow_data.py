"""Samples of the scan flow: aligned past scans with the true velocity of each return."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from navrl.files import replacing
from navrl.ops import se2
from navrl.untrusted import DamagedFileError, read_arrays

MAX_BODY_M = 0.7  # m from the center of a pedestrian to a point on its body or legs
MAX_SPEED_MPS = 3.0  # a faster pedestrian was moved by the simulation, it did not walk
_MAX_BYTES = 8 * 2**30
_REMEDY = "delete it, and the same command records it again"
_KINDS = {"ranges": "float16", "returns": "bool", "shown": "bool", "velocity": "float16"}


@dataclass(frozen=True)
class FlowSamples:
    """Scans of S times with the true motion of their N returns.

    Args:
        ranges: ``[S, K + 1, N]`` float16 m, scan t first, past scans in the robot frame at t: the
            second output of :class:`navrl.transforms.RangeHistory`.
        returns: ``[S, N]`` bool, the bin has a return at t.
        shown: ``[S, N]`` bool, that return is of a pedestrian.
        velocity: ``[S, N, 2]`` float16 m/s of that pedestrian, radial and counter-clockwise
            tangential at the bearing of the return; zero for other returns.
    """

    ranges: Tensor
    returns: Tensor
    shown: Tensor
    velocity: Tensor

    def __len__(self) -> int:
        """Return S."""
        return len(self.returns)

    def __getitem__(self, rows: Tensor | slice) -> FlowSamples:
        """Return the chosen samples."""
        return FlowSamples(*(value[rows] for value in self.tensors().values()))

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def to(self, device: torch.device | str) -> FlowSamples:
        """Move all tensors."""
        return FlowSamples(*(value.to(device) for value in self.tensors().values()))

    @classmethod
    def joined(cls, parts: Iterable[FlowSamples]) -> FlowSamples:
        """Return the samples of all parts, in order; there must be at least one part."""
        rows = [part.tensors() for part in parts]
        return cls(*(torch.cat([row[name] for row in rows]) for name in _KINDS))

    def augmented(self, is_mirrored: Tensor, shift: Tensor) -> FlowSamples:
        """Return the samples as another robot sees them: mirrored, then rotated.

        Args:
            is_mirrored: ``[S]`` bool, left and right are exchanged.
            shift: ``[S]`` int64, bins by which the scene is rotated counter-clockwise.
        """
        count = self.returns.shape[-1]
        source = (torch.arange(count, device=shift.device) - shift[:, None]) % count
        source = torch.where(is_mirrored[:, None], count - 1 - source, source)
        sign = torch.where(is_mirrored, -1.0, 1.0).to(self.velocity.dtype)
        velocity = self.velocity.gather(1, source[..., None].expand_as(self.velocity))
        return FlowSamples(
            ranges=self.ranges.gather(2, source[:, None].expand_as(self.ranges)),
            returns=self.returns.gather(1, source),
            shown=self.shown.gather(1, source),
            velocity=torch.stack((velocity[..., 0], velocity[..., 1] * sign[:, None]), dim=-1),
        )

    def save(self, file: Path) -> None:
        """Write the samples to an ``.npz`` file, which is complete or missing.

        Raises:
            OSError: If writing fails.
        """
        arrays: dict[str, Any] = {name: value.numpy() for name, value in self.tensors().items()}
        with replacing(file) as stream:
            np.savez(stream, **arrays)

    @classmethod
    def load(cls, file: Path) -> FlowSamples:
        """Read a file of :meth:`save`.

        Raises:
            OSError: If there is no such file.
            DamagedFileError: If it is damaged or has other arrays.
        """
        arrays = read_arrays(file, _REMEDY, _MAX_BYTES)
        found = {name: str(value.dtype) for name, value in arrays.items()}
        if found != _KINDS:
            raise DamagedFileError(file, f"arrays={found}: must be {_KINDS}", _REMEDY)
        shapes = {name: tuple(value.shape) for name, value in arrays.items()}
        size = shapes["returns"]
        wanted = {
            "ranges": (*size[:1], *shapes["ranges"][1:2], *size[1:]),
            "returns": size,
            "shown": size,
            "velocity": (*size, 2),
        }
        if len(size) != 2 or shapes != wanted:
            raise DamagedFileError(file, f"shapes={shapes}: do not fit each other", _REMEDY)
        return cls(**{name: torch.from_numpy(value) for name, value in arrays.items()})


def polar_velocity(velocity: Tensor, points: Tensor) -> Tensor:
    """Return velocities as radial and counter-clockwise tangential parts.

    Args:
        velocity: ``[*B, 2]`` m/s, robot frame.
        points: ``[*B, 2]`` m, where they are measured, robot frame.

    Example:
        >>> polar_velocity(torch.tensor([1.0, 2.0]), torch.tensor([0.0, 3.0]))
        tensor([ 2.0000, -1.0000])
    """
    return se2.rotate(velocity, -torch.atan2(points[..., 1], points[..., 0]))


def return_velocity(
    points: Tensor, shown: Tensor, pose: Tensor, before: Tensor, after: Tensor, duration_s: float
) -> tuple[Tensor, Tensor]:
    """Return the velocity of each return that shows a pedestrian.

    Args:
        points: ``[W, N, 2]`` m, returns in the robot frame.
        shown: ``[W, N]`` bool, the return is of a pedestrian.
        pose: ``[W, 3]`` true pose of the robot, m and rad, world frame.
        before: ``[W, K, 2]`` m, pedestrians at the time of the scan, world frame; NaN if absent.
        after: ``[W, K, 2]`` m, the same pedestrians later.
        duration_s: Time in between, s.

    Returns:
        ``[W, N]`` bool, the return is within :data:`MAX_BODY_M` of a pedestrian that it shows, and
        ``[W, N, 2]`` m/s, radial and counter-clockwise tangential; zero for other returns.
    """
    yaw = pose[:, None, 2]
    place = se2.rotate(before - pose[:, None, :2], -yaw)
    velocity = se2.rotate((after - before) / duration_s, -yaw).nan_to_num()
    distance, nearest = torch.cdist(points, place.nan_to_num(nan=1e4)).min(dim=-1)
    shown = shown & (distance < MAX_BODY_M)
    own = velocity.gather(1, nearest[..., None].expand(-1, -1, 2))
    return shown, polar_velocity(own, points).masked_fill(~shown[..., None], 0.0)
