"""Mount of a lidar by the motion of its scans."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch

from navrl.ops.icp import align
from navrl.ops.icp_options import ROBUST
from navrl.sim import Lidar

FINE = Lidar(num_beams=360, max_range=10.0)
"""Layout of the scans that are aligned, in the scanner's own frame."""
PAIR_M, PAIR_RAD = 0.15, 0.15
"""Motion between the scans of a pair, m or rad."""


class MountGuess(NamedTuple):
    """Mount of the lidar by the motion of its scans."""

    yaw: float | None
    """rad in the robot frame; None if the robot did not drive straight far enough."""
    agreement: float
    """Length of the mean direction, 1 if all pairs of scans agree."""
    is_mirrored: bool | None
    """Whether scans turn against odometry; None if the robot did not turn."""
    num_pairs: int
    """Pairs of scans."""


def mount_by_motion(moves: list[tuple[np.ndarray, np.ndarray]]) -> MountGuess:
    """Return the yaw of a lidar from pairs of motions.

    While the robot drives straight, its scans move against the direction in which the lidar sees
    the front of the robot; while it turns, a mirrored lidar sees it turn the other way.

    Args:
        moves: Pairs of ``[3]`` (x, y, yaw) of the earlier frame in the later one, of the robot by
            odometry, and of the lidar by the alignment of its scans, m and rad.
    """
    turns = [(r[2], s[2]) for r, s in moves if abs(r[2]) > 0.08 and abs(s[2]) > 0.04]
    is_mirrored = None
    if len(turns) >= 3:
        is_mirrored = sum(r * s < 0.0 for r, s in turns) > 0.5 * len(turns)
    sign = -1.0 if is_mirrored else 1.0
    straight = [
        math.atan2(r[1], r[0]) - math.atan2(sign * s[1], s[0])
        for r, s in moves
        if math.hypot(r[0], r[1]) > 0.8 * PAIR_M
        and abs(r[2]) < 0.1
        and 0.5 < math.hypot(s[0], s[1]) / math.hypot(r[0], r[1]) < 2.0
    ]
    if len(straight) < 3:
        return MountGuess(None, 0.0, is_mirrored, len(moves))
    mean = np.exp(1j * np.array(straight)).mean()
    return MountGuess(float(np.angle(mean)), float(np.abs(mean)), is_mirrored, len(moves))


def aligned(source: np.ndarray, target: np.ndarray) -> np.ndarray | None:
    """Return the earlier scan's frame in that of the later one, ``[3]``; None if not aligned."""
    angles = FINE.beam_angles().numpy()
    scans = []
    for distance in (source, target):
        is_return = np.isfinite(distance) & (distance > 0.0)
        reach = np.where(is_return, distance, 0.0)
        points = reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        scans += [torch.from_numpy(points), torch.from_numpy(is_return)]
    found = align(*scans, options=ROBUST)
    return found.transform.numpy() if bool(found.converged) else None


def true_sectors(flags: np.ndarray) -> list[tuple[float, float]]:
    """Return (bearing, width) of the runs of beams that are true, rad; joined over the seam."""
    if not flags.any() or flags.all():
        return []
    first = int(np.argmin(flags))  # a beam that is false, so that no run crosses the seam
    rolled = np.roll(flags, -first)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rolled, [False]]).astype(np.int8)))
    step = 2.0 * math.pi / len(flags)
    return [
        (
            round(math.remainder((first + 0.5 * (start + end - 1)) * step, math.tau), 3),
            round((end - start) * step, 3),
        )
        for start, end in edges.reshape(-1, 2).tolist()
    ]
