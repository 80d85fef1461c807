"""Scans of a room and their alignment as a module, for tests of exported graphs."""

import math

import torch
from torch import nn

from navrl.ops.icp import align


class Aligned(nn.Module):
    def __init__(self, options):
        super().__init__()
        self.options = options

    def forward(self, source, returns, target):
        found = align(source, returns, target, returns, self.options)
        return found.transform, found.converged, found.inliers


def scans(generator, count=4, num_points=60):
    """A room seen from two places, one of the rows without a return."""
    angle = torch.arange(num_points) * (2.0 * math.pi / num_points)
    reach = 1.5 + 0.5 * torch.cos(4.0 * angle) + 0.01 * torch.rand(count, num_points)
    source = reach.unsqueeze(-1) * torch.stack([angle.cos(), angle.sin()], dim=-1)
    shift = 0.1 * torch.rand(count, 1, 2, generator=generator)
    returns = torch.ones(count, num_points, dtype=torch.bool)
    returns[-1] = False
    return source, returns, source + shift
