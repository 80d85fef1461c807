"""Scenarios of every kind, and drivers that meet walls and people."""

from __future__ import annotations

import functools
import math

import numpy as np
import torch
from torch import Tensor

from navrl.worlds import (
    Corridor,
    Intersection,
    Office,
    Pedestrian,
    Scenario,
    ScenarioDistribution,
    WeightedWorld,
)

WORLDS = {"corridor": Corridor(), "intersection": Intersection(), "office": Office()}


@functools.cache
def sample(kind: str, index: int) -> Scenario:
    """Return a scenario of a world of the paper, with up to 8 + 2 pedestrians, or of clutter."""
    if kind == "clutter":
        return clutter(index)
    return _distribution(kind).sample(f"parity-{kind}", 7, index)


@functools.cache
def _distribution(kind: str) -> ScenarioDistribution:
    return ScenarioDistribution({kind: WeightedWorld(WORLDS[kind])}, num_dynamic=(1, 8))


def clutter(index: int) -> Scenario:
    """Turned boxes of all sizes, thin ones too, and people of all sizes on zigzag routes."""
    generator = np.random.default_rng([5, index])
    boxes = np.column_stack(
        [
            generator.uniform(-5, 5, (24, 2)),
            generator.uniform(0.0, 1.0, (24, 2)) ** 3,
            generator.uniform(-10, 10, 24),
        ]
    )
    boxes = boxes[np.hypot(boxes[:, 0], boxes[:, 1]) - np.hypot(boxes[:, 2], boxes[:, 3]) > 0.3]
    people = [
        Pedestrian(
            route=np.cumsum(generator.uniform(-1.5, 1.5, (generator.integers(2, 8), 2)), axis=0),
            speed=generator.uniform(0.3, 1.5),
            offset=generator.uniform(0.0, 4.0),
            half_size=tuple(generator.uniform(0.05, 0.3, 2)),
        )
        for _ in range(generator.integers(0, 8))
    ]
    people += [Pedestrian(generator.uniform(-3, 3, (1, 2)), 0.0, 0.0) for _ in range(2)]
    yaw = generator.uniform(-math.pi, math.pi)
    goal = 4.0 * np.array([math.cos(yaw), math.sin(yaw)])
    path = np.linspace(0.0, 1.0, 41)[:, None] * goal
    start = np.array([0.0, 0.0, yaw])
    return Scenario(
        "clutter", 5, index, "clutter", boxes, start, goal, path, tuple(people), noise_seed=index
    )


class Drivers:
    """One driver a world: along the path at full speed whoever is there, at random, or standing.

    Args:
        num_worlds: N.
        seed: of all that is random.
    """

    def __init__(self, num_worlds: int, seed: int) -> None:
        self._generator = torch.Generator().manual_seed(seed)
        self._style = torch.zeros(num_worlds, dtype=torch.int64)
        self._wander = torch.zeros(num_worlds, 2)

    def change(self, worlds: Tensor) -> None:
        """Draw new drivers for these worlds."""
        self._style[worlds] = torch.randint(0, 4, (len(worlds),), generator=self._generator)

    def command(self, pose: Tensor, path: Tensor) -> Tensor:
        """Return (v, w) [N, 2], now and then beyond the limits, for poses [N, 3] and paths."""
        draw = torch.rand(len(pose), 2, generator=self._generator)
        self._wander = 0.7 * self._wander + 0.3 * (draw - 0.5)
        wander = self._wander * torch.tensor([6.0, 20.0]) + torch.tensor([0.5, 0.0])
        nearest = (path - pose[:, None, :2]).norm(dim=-1).argmin(-1)
        ahead = (nearest + 5).clamp_max(path.shape[1] - 1)
        offset = path[torch.arange(len(pose)), ahead] - pose[:, :2]
        turn = torch.atan2(offset[:, 1], offset[:, 0]) - pose[:, 2]
        turn = torch.atan2(turn.sin(), turn.cos())
        pursuit = torch.stack((torch.cos(turn).clamp_min(0.0), 3.0 * turn), dim=-1)
        style = self._style[:, None]
        command = torch.where(style == 0, wander, pursuit)
        return torch.where(style == 3, torch.zeros(()), command)
