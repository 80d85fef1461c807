"""Print the share of right alignments of a standing robot's scans, by option and range.

Run ``python tests/ops/alignment_standing.py legtracker_demo_60s.npz``: 60 s of a real lidar among
people (Leigh et al., ICRA 2015; 512 beams, 180 deg, 10 Hz, 5.6 m). The robot does not move, so an
alignment of two scans, 0.2 s apart, is right if it is within 0.1 m and 2 deg of no motion. The
odometry of the prior has an error of 1 cm and 0.6 deg (1 sigma).
"""

from __future__ import annotations

import sys

import numpy as np
import torch
from alignment_log import ODOMETRY

from navrl.deploy import adapt_scan
from navrl.ops.icp import align
from navrl.ops.icp_options import PAPER, ROBUST
from navrl.ops.icp_quality import align_from_prior
from navrl.ops.scanner import Scanner
from navrl.sim import Lidar
from navrl.transforms import MinPool

RANGES_M = (3.5, 5.6)  # of the network; of the lidar
EVERY = 2  # scans: 10 Hz recorded, 5 Hz of the policy


def read(file: str) -> torch.Tensor:
    """Return the scans ``[S, 1440]`` m, inf where nothing is seen."""
    with np.load(file) as log:
        readings = log["range_mm"][::EVERY] / 1000.0
        angles = (float(log["angle_min"]), float(log["angle_increment"]))
        range_max = float(log["range_max"])
    scanner = Scanner(angle_min=angles[0], angle_increment=angles[1], range_max=range_max)
    scans = np.stack([adapt_scan(scan, scanner, Lidar()).ranges for scan in readings])
    is_return = np.isfinite(scans) & (scans > 0.0) & (scans < range_max - 0.05)
    return torch.tensor(np.where(is_return, scans, np.inf)).float()


def main(file: str) -> None:
    """Print the rows of a Markdown table."""
    ranges = read(file)
    random = torch.randn(len(ranges) - 1, 3, generator=torch.Generator().manual_seed(0))
    for reach in RANGES_M:
        _, points, returns = MinPool(max_range=reach)(ranges=ranges.clamp(max=reach))
        scans = (points[:-1], returns[:-1], points[1:], returns[1:])
        for name, found in (
            ("paper", align(*scans, PAPER)),
            ("robust", align(*scans, ROBUST)),
            ("robust, prior that holds", align_from_prior(ODOMETRY * random, *scans, ROBUST)),
        ):
            off, turn = found.transform[:, :2].norm(dim=-1), found.transform[:, 2].abs()
            is_right = (off <= 0.1) & (turn <= np.radians(2.0))
            print(f"| {name} | {reach:g} | {100.0 * float(is_right.float().mean()):.1f} |")


if __name__ == "__main__":
    main(sys.argv[1])
