"""Print the share of right alignments on the log of a robot, and how well the quality tells them.

Run ``python tests/ops/alignment_log.py LOG``, e.g. on a CARMEN log with corrected poses. A pair of
successive scans is right within 0.1 m and 2 deg of the poses, and moving beyond 0.05 m or 2 deg.
Such a log has no odometry besides; the prior is the motion of the poses with noise. The last column
is the area under the ROC curve of the quality for alignments that are off by more than 0.1 m.
"""

from __future__ import annotations

import sys
from contextlib import closing

import numpy as np
import torch
from torch import Tensor

from navrl.deploy import adapt_scan
from navrl.deploy.bags import LoggedPose, LoggedScan, LogSource, Topics, open_log
from navrl.deploy.doctor import scan_layout
from navrl.ops import se2
from navrl.ops.icp import align
from navrl.ops.icp_options import PAPER, ROBUST, IcpOptions
from navrl.ops.icp_quality import align_from_prior, alignment_quality
from navrl.ops.scanner import Scanner
from navrl.sim import Lidar
from navrl.transforms import MinPool

RANGES_M = (3.5, 8.0)  # of the network; of the lidar of an office
MAX_GAP_S = 0.3
ODOMETRY = torch.tensor([0.01, 0.002, 0.01])  # m, m, rad, standard deviation of a step's error


def read(file: str) -> tuple[Tensor, Tensor, Tensor]:
    """Return stamps ``[S]`` s, poses ``[S, 3]`` and ranges ``[S, 1440]`` m, inf where unseen."""
    lidar, stamps, poses, ranges = Lidar(), [], [], []
    with closing(open_log(file)) as log:
        source = LogSource(log, Topics(pose_source="pose"))
        plain, scan = Scanner(range_max=80.0), None
        for message in source.messages():
            if isinstance(message, LoggedScan):
                scan = message
            elif isinstance(message, LoggedPose) and scan is not None:
                scanner, _ = source.scanner(scan, plain)
                adapted = adapt_scan(scan.ranges, scan_layout(scanner, scan), lidar).ranges
                ranges.append(np.where(np.isfinite(adapted) & (adapted > 0.0), adapted, np.inf))
                stamps.append(scan.stamp)
                poses.append(message.pose)
                scan = None
    return tuple(torch.tensor(np.array(values)) for values in (stamps, poses, ranges))


def quality_score(transform: Tensor, scans: tuple[Tensor, ...], options: IcpOptions) -> Tensor:
    """Return ``[N]``, 1 at the thresholds of ``converged=quality``, less for a worse alignment."""
    found = alignment_quality(transform, *scans, options)
    parts = (
        found.inlier_share / 0.8,
        0.035 / found.rms.clamp_min(1e-4),
        found.eigenvalues[:, 0] / 0.1,
    )
    return torch.stack(parts).amin(0)


def area_under_curve(score: Tensor, is_wrong: Tensor) -> float:
    """Return the probability that a wrong alignment has a lower score than a right one."""
    wrong, right = score[is_wrong, None], score[~is_wrong]
    return float(((wrong < right).float() + 0.5 * (wrong == right)).mean())


def main(file: str) -> None:
    """Print the rows of a Markdown table."""
    stamps, poses, ranges = read(file)
    moved = se2.relative(poses[1:], poses[:-1])
    is_moving = (moved[:, :2].norm(dim=-1) > 0.05) | (moved[:, 2].abs() > np.radians(2.0))
    pairs = (is_moving & (stamps.diff() <= MAX_GAP_S)).nonzero()[:, 0]
    moved, after = moved[pairs], pairs + 1
    noise = torch.randn(moved.shape, generator=torch.Generator().manual_seed(0))
    odometry = se2.compose(moved, ODOMETRY * noise).float()
    print(f"{file}: {len(pairs)} moving pairs of scans within {MAX_GAP_S} s")
    for reach in RANGES_M:
        _, points, returns = MinPool(max_range=reach)(ranges=ranges.float().clamp(max=reach))
        scans = (points[pairs], returns[pairs], points[after], returns[after])
        for name, options, found in (
            ("paper", PAPER, align(*scans, PAPER)),
            ("robust", ROBUST, align(*scans, ROBUST)),
            ("robust, prior that holds", ROBUST, align_from_prior(odometry, *scans, ROBUST)),
        ):
            position = (found.transform[:, :2] - moved[:, :2]).norm(dim=-1)
            turn = se2.wrap_angle(found.transform[:, 2] - moved[:, 2]).abs()
            is_right = (position <= 0.1) & (turn <= np.radians(2.0))
            score = quality_score(found.transform, scans, options)
            area = area_under_curve(score, position > 0.1)
            share = 100.0 * float(is_right.float().mean())
            print(f"| {name} | {reach:g} | {share:.1f} | {area:.2f} |")


if __name__ == "__main__":
    main(sys.argv[1])
