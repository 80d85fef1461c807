"""Ray casting of a planar lidar against oriented boxes."""

import functools
import math

import torch
from torch import Tensor

from navrl.ops.backend import Backend, as_real, check_same_device, is_compiled


def cast_rays(
    pose: Tensor,
    boxes: Tensor,
    num_boxes: Tensor | None = None,
    num_beams: int = 1440,
    max_range: float = 3.5,
    backend: Backend = "auto",
    angle_min: float = 0.0,
    angle_increment: float | None = None,
) -> Tensor:
    """Return the distance along each beam to the nearest box.

    Beam j points at ``angle_min + j angle_increment`` from the pose's x axis. A scanner inside
    of a box, or on its edge, reads 0 in every beam. A world without boxes reads ``max_range``.

    Args:
        pose: [*B, 3] (x, y, yaw) of the scanner, world.
        boxes: [*B, K, 5] (cx, cy, hx, hy, yaw), world, half sizes in m; NaN rows are absent.
        num_boxes: [*B] int64, leading rows of ``boxes`` that count; all of them if None.
        num_beams: Beams per scan.
        max_range: Range of a beam that hits nothing nearer, m.
        backend: See :mod:`navrl.ops.backend`. The kernel's geometry is float64, that of the torch
            form, one slab test per beam and box, has the dtype of ``pose``. They agree to 1e-4 m
            but for beams that graze an edge.
        angle_min: Angle of beam 0, rad.
        angle_increment: Angle between successive beams, rad, negative if counted clockwise;
            None spreads the beams evenly over a full circle, counter-clockwise.

    Returns:
        [*B, num_beams] float32 m.

    Raises:
        ValueError: If shapes or devices do not match, a pose is not finite, or a half size is
            negative.

    Example:
        >>> boxes = torch.tensor([[2.0, 0.0, 0.5, 0.5, 0.0]])
        >>> cast_rays(torch.zeros(3), boxes, num_beams=4)
        tensor([1.5000, 3.5000, 3.5000, 3.5000])
    """
    num_boxes = _check(pose, boxes, num_boxes, num_beams, max_range)
    pose, boxes = as_real(pose), as_real(boxes)
    beams = (num_beams, angle_min, angle_increment)
    if is_compiled(backend, pose, boxes):
        return _cast_rays_compiled(pose, boxes, num_boxes, beams, max_range)
    return _cast_rays_torch(pose, boxes, num_boxes, beams, max_range)


def _check(
    pose: Tensor, boxes: Tensor, num_boxes: Tensor | None, num_beams: int, max_range: float
) -> Tensor:
    """Check the arguments of :func:`cast_rays`; return ``num_boxes`` or its default."""
    batch = pose.shape[:-1]
    if pose.ndim < 1 or pose.shape[-1] != 3:
        raise ValueError(f"pose: must be [*B, 3], got {list(pose.shape)}")
    if boxes.ndim != pose.ndim + 1 or boxes.shape[:-2] != batch or boxes.shape[-1] != 5:
        raise ValueError(f"boxes: must be {[*batch, 'K', 5]}, got {list(boxes.shape)}")
    if num_boxes is None:
        num_boxes = torch.full(batch, boxes.shape[-2], dtype=torch.int64, device=pose.device)
    if num_boxes.shape != batch or num_boxes.is_floating_point():
        raise ValueError(
            f"num_boxes: must be {list(batch)} integers, "
            f"got {list(num_boxes.shape)} {num_boxes.dtype}"
        )
    check_same_device(pose=pose, boxes=boxes, num_boxes=num_boxes)
    if num_beams < 1:
        raise ValueError(f"num_beams={num_beams}: must be at least 1")
    if not (max_range > 0.0 and math.isfinite(max_range)):
        raise ValueError(f"max_range={max_range}: must be positive and finite (m)")
    if not bool(torch.isfinite(pose).all()):
        raise ValueError("pose: must be finite, got NaN or infinity")
    if bool((boxes[..., 2:4] < 0.0).any()):
        raise ValueError("boxes: must have half sizes hx, hy >= 0, got a negative value")
    if bool(((num_boxes < 0) | (num_boxes > boxes.shape[-2])).any()):
        raise ValueError(f"num_boxes: must be within 0..{boxes.shape[-2]}")
    return num_boxes


Beams = tuple[int, float, float | None]
"""Number of beams, angle of beam 0 and increment, rad; None spreads them over a full circle."""


def beam_angles(num_beams: int, angle_min: float, angle_increment: float | None) -> Tensor:
    """Return the angle of each beam in the scanner's frame, [num_beams] float64 rad.

    Example:
        >>> beam_angles(3, -0.5, 0.5).tolist()
        [-0.5, 0.0, 0.5]
    """
    increment = 2.0 * math.pi / num_beams if angle_increment is None else angle_increment
    return angle_min + torch.arange(num_beams, dtype=torch.float64) * increment


@functools.lru_cache(maxsize=16)
def beam_directions(
    num_beams: int,
    angle_min: float = 0.0,
    angle_increment: float | None = None,
    device: torch.device | str = "cpu",
) -> Tensor:
    """Return [2, num_beams] float64 (cos, sin) of the beam angles; cached, read-only.

    Example:
        >>> beam_directions(4).round(decimals=3).abs()[0].tolist()
        [1.0, 0.0, 1.0, 0.0]
    """
    angle = beam_angles(num_beams, angle_min, angle_increment)
    return torch.stack((torch.cos(angle), torch.sin(angle))).to(device)


def beam_grid(
    num_beams: int, angle_min: float, angle_increment: float | None
) -> tuple[float, float, float]:
    """Return the parameters by which the kernels convert an angle to a beam.

    Returns:
        Angle of beam 0, rad; beams per radian, negative if they are counted clockwise; beams of a
        full circle.

    Example:
        >>> beam_grid(3, -0.5, 0.5)[:2]
        (-0.5, 2.0)
    """
    angle_min = math.remainder(angle_min, 2.0 * math.pi)
    if angle_increment is None:
        return angle_min, num_beams / (2.0 * math.pi), float(num_beams)
    return angle_min, 1.0 / angle_increment, 2.0 * math.pi / abs(angle_increment)


def _cast_rays_compiled(
    pose: Tensor, boxes: Tensor, num_boxes: Tensor, beams: Beams, max_range: float
) -> Tensor:
    from navrl.ops.kernels.rays import cast_rows

    batch, count = pose.shape[:-1], pose.shape[:-1].numel()
    ranges = cast_rows(
        pose.reshape(count, 3).double(),
        boxes.reshape(count, boxes.shape[-2], 5).double(),
        num_boxes.reshape(count).long(),
        beam_directions(*beams, pose.device),
        beam_grid(*beams),
        float(max_range),
    )
    return ranges.reshape(*batch, beams[0])


def _cast_rays_torch(
    pose: Tensor, boxes: Tensor, num_boxes: Tensor, beams: Beams, max_range: float
) -> Tensor:
    """Test every beam against every box (slab method); needs [*B, K, beams] of memory."""
    boxes = boxes.to(pose.dtype)
    absent = torch.arange(boxes.shape[-2], device=pose.device) >= num_boxes[..., None]
    absent = absent | boxes.isnan().any(-1)
    center, half, turn = boxes[..., :2], boxes[..., 2:4], boxes[..., 4]
    cos, sin = torch.cos(turn), torch.sin(turn)
    offset = pose[..., None, :2] - center
    # scanner and beams in each box's frame: [*B, K, 1, 2] and [*B, K, beams, 2]
    origin = torch.stack(
        (
            cos * offset[..., 0] + sin * offset[..., 1],
            cos * offset[..., 1] - sin * offset[..., 0],
        ),
        dim=-1,
    )
    angle = beam_angles(*beams).to(pose) + (pose[..., None, 2:3] - turn[..., None])
    direction = torch.stack((torch.cos(angle), torch.sin(angle)), dim=-1)
    # the interval of each beam between the two planes of each axis
    near = (-half - origin)[..., None, :] / direction
    far = (half - origin)[..., None, :] / direction
    is_parallel = direction == 0.0
    is_between = (origin.abs() <= half)[..., None, :]
    never = torch.where(is_between, -torch.inf, torch.inf).to(pose.dtype)
    enter = torch.where(is_parallel, never, torch.minimum(near, far)).amax(-1)
    leave = torch.where(is_parallel, -never, torch.maximum(near, far)).amin(-1)
    is_inside = (origin.abs() <= half).all(-1)[..., None]
    reach = torch.where((enter <= leave) & (enter >= 0.0), enter, torch.inf)
    reach = torch.where(is_inside, 0.0, reach).masked_fill(absent[..., None], torch.inf)
    if reach.shape[-2] == 0:
        return torch.full((*pose.shape[:-1], beams[0]), max_range, device=pose.device)
    return reach.amin(-2).clamp_max(max_range).float()
