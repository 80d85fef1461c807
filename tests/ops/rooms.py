"""Random rooms with moving pedestrians: pairs of scans with a known motion between them."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navrl.ops import se2
from navrl.ops.pooling import PooledScan, min_pool

MAX_RANGE = 3.5  # m
MAX_TURN = math.radians(36.0)  # pi rad/s for 0.2 s
MAX_TRANSLATION = 0.2  # m, 1 m/s for 0.2 s


class ScanPairs(NamedTuple):
    """Two scans of each room and the motion between them."""

    source: PooledScan  # scan t-1
    target: PooledScan  # scan t
    T_target_source: Tensor  # [S, 3]


def cast(pose: Tensor, boxes: Tensor, num_beams: int) -> Tensor:
    """Return noise-free ranges ``[S, beams]`` m from ``pose [S, 3]`` to ``boxes [S, W, 5]``."""
    beam = torch.arange(num_beams, dtype=pose.dtype) * (2 * math.pi / num_beams)
    yaw = boxes[..., 4].unsqueeze(-1)
    angle = pose[:, 2, None, None] + beam - yaw  # [S, W, beams], in each box's frame
    direction = torch.stack([angle.cos(), angle.sin()], dim=-1)
    origin = se2.rotate(pose[:, None, :2] - boxes[..., :2], -boxes[..., 4]).unsqueeze(-2)
    half = boxes[..., 2:4].unsqueeze(-2)
    near = (-half - origin) / direction
    far = (half - origin) / direction
    entry = torch.minimum(near, far).amax(-1)
    leave = torch.maximum(near, far).amin(-1)
    hit = (entry <= leave) & (entry > 0)
    return torch.where(hit, entry, MAX_RANGE).amin(1).clamp(max=MAX_RANGE)


def sample_scan_pairs(
    count: int,
    seed: int = 0,
    beams_per_point: int = 1,
    num_points: int = 180,
    noise_std: float = 0.025,
    num_pedestrians: int = 2,
) -> ScanPairs:
    """Sample rooms of 3-8 m with 0-4 boxes, walkers at 0.5-1 m/s, turns of up to 36 deg."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        draw = torch.rand(*shape, generator=generator, dtype=torch.float64)
        return low + (high - low) * draw

    size = torch.stack([uniform(2.0, 4.0, count), uniform(1.0, 4.0, count)], -1)  # half sizes
    pose_before = torch.cat(
        [uniform(-1, 1, count, 2) * (size - 0.5), uniform(-math.pi, math.pi, count, 1)], dim=-1
    )
    motion = torch.stack(
        [
            uniform(0.0, MAX_TRANSLATION, count),
            uniform(-0.05, 0.05, count),
            uniform(-MAX_TURN, MAX_TURN, count),
        ],
        dim=-1,
    )
    pose_after = se2.compose(pose_before, motion)
    furniture = _around(uniform, size, pose_before, 4, (0.1, 0.5), clearance=0.9)
    walkers = _around(uniform, size, pose_before, num_pedestrians, (0.13, 0.15), clearance=0.6)
    step = uniform(0.5, 1.0, count, num_pedestrians) * 0.2
    moved = walkers.clone()
    moved[..., 0] += step * walkers[..., 4].cos()
    moved[..., 1] += step * walkers[..., 4].sin()
    static = torch.cat([_walls(size), furniture], dim=1)
    scans = []
    for pose, people in ((pose_before, walkers), (pose_after, moved)):
        ranges = cast(pose, torch.cat([static, people], dim=1), beams_per_point * num_points)
        noise = noise_std * torch.randn(ranges.shape, generator=generator, dtype=torch.float64)
        ranges = torch.where(ranges < MAX_RANGE, (ranges + noise).clamp(0.05, 3.499), MAX_RANGE)
        scans.append(min_pool(ranges.float(), beams_per_point, MAX_RANGE))
    T_target_source = se2.relative(pose_after, pose_before).float()
    return ScanPairs(scans[0], scans[1], T_target_source)


def corridor_pairs(count: int = 60, walked: float = 0.2) -> ScanPairs:
    """Scans in a corridor of 2 m whose ends are out of range, with a pedestrian ahead."""
    generator = torch.Generator().manual_seed(1)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(count, generator=generator, dtype=torch.float64)

    none = torch.zeros(count, dtype=torch.float64)
    before = torch.stack([none, uniform(-0.4, 0.4), uniform(-0.3, 0.3)], dim=-1)
    motion = torch.stack([uniform(0.0, 0.1), none, uniform(-0.2, 0.2)], dim=-1)
    after = se2.compose(before, motion)
    walls = [torch.stack([none, none + y, none + 50, none + 0.1, none], -1) for y in (1.1, -1.1)]
    x, y = uniform(0.8, 2.0), uniform(-0.5, 0.5)
    scans = []
    for pose, ahead in ((before, x), (after, x + walked)):
        person = torch.stack([ahead, y, none + 0.15, none + 0.14, none], -1)
        ranges = cast(pose, torch.stack([*walls, person], dim=1), 1440)
        noise = 0.025 * torch.randn(ranges.shape, generator=generator, dtype=torch.float64)
        ranges = torch.where(ranges < 3.5, (ranges + noise).clamp(0.05, 3.499), 3.5)
        scans.append(min_pool(ranges.float(), 8))
    return ScanPairs(*scans, se2.relative(after, before).float())


def _walls(size: Tensor) -> Tensor:
    """Four walls of 0.2 m around rooms of half size ``size [S, 2]``: ``[S, 4, 5]``."""
    hx, hy = size.unbind(-1)
    zero, thin = torch.zeros_like(hx), torch.full_like(hx, 0.1)
    rows = [
        (hx + 0.1, zero, thin, hy + 0.2, zero),
        (-hx - 0.1, zero, thin, hy + 0.2, zero),
        (zero, hy + 0.1, hx + 0.2, thin, zero),
        (zero, -hy - 0.1, hx + 0.2, thin, zero),
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], dim=1)


def _around(uniform, size, pose, number, half_range, clearance) -> Tensor:
    """Boxes ``[S, number, 5]`` in the room; those too near the robot are sent outside."""
    count = len(size)
    center = uniform(-1, 1, count, number, 2) * size.unsqueeze(1)
    half = uniform(*half_range, count, number, 2)
    yaw = uniform(-math.pi, math.pi, count, number, 1)
    near = (center - pose[:, None, :2]).norm(dim=-1) < clearance
    center = torch.where(near.unsqueeze(-1), 100.0, center)
    return torch.cat([center, half, yaw], dim=-1)


def errors(estimate: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    """Return position error in m and rotation error in degrees, ``[S]`` each."""
    difference = se2.compose(se2.inverse(truth), estimate)
    return difference[:, :2].norm(dim=-1), difference[:, 2].abs().rad2deg()
