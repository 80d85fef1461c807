"""Where points seen by the lidar are going, and the room an arc leaves between them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

FAR = 100.0
"""m, where points go that are no obstacle."""


def point_motion(
    points: Tensor,
    tagd: Tensor,
    valid: Tensor,
    *,
    least: float,
    most: float,
    group_radius: float,
) -> Tensor:
    """Return how far each point moves in a step, if it belongs to a descriptor that moved.

    A descriptor (c_{t-1}, c_t) is where a group was and is: it is taken to walk on like that, and
    so are the points around it.

    Args:
        points: ``[N, P, 2]`` m, robot frame.
        tagd: ``[N, G, 4]`` m, (c_{t-1}, c_t) in the same frame.
        valid: ``[N, G, 2]`` bool, which halves are real.
        least: m a step; slower is noise of scan and alignment.
        most: m a step; faster is a mismatch.
        group_radius: m around c_t within which points move with it.

    Returns:
        ``[N, P, 2]`` m a step, zero for what stands.
    """
    before, now = tagd.split(2, dim=-1)
    motion = now - before
    length = motion.norm(dim=-1)
    moved = valid.all(-1) & (length > least) & (length < most)
    gap = torch.cdist(points, torch.where(moved.unsqueeze(-1), now, -FAR))
    nearest, group = gap.min(dim=-1, keepdim=True)
    carried = motion.gather(1, group.expand(*group.shape[:-1], 2))
    return torch.where(nearest <= group_radius, carried, 0.0)


def room_along(places: Tensor, points: Tensor, motion: Tensor, steps: Sequence[float]) -> Tensor:
    """Return the distance from each place on an arc to the nearest point at that time.

    Args:
        places: ``[N, S, T, 2]`` m, on S arcs at T times, robot frame of time 0.
        points: ``[N, P, 2]`` m at time 0; what is no obstacle lies :data:`FAR` away.
        motion: ``[N, P, 2]`` m a step.
        steps: T times, in steps.

    Returns:
        ``[N, S, T]`` m.
    """
    gaps = [
        torch.cdist(places[:, :, k], points + step * motion).amin(-1)
        for k, step in enumerate(steps)
    ]
    return torch.stack(gaps, dim=-1)
