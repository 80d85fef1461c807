"""Print the share of wrong alignments by option.

Run ``python tests/ops/alignment_table.py``.
A pair is wrong if the position is off by more than 3 cm or the yaw by more than 2 deg.
"""

from __future__ import annotations

import torch
from alignment_log import ODOMETRY, quality_score
from rooms import ScanPairs, corridor_pairs, errors, sample_scan_pairs
from torch import Tensor

from navrl.ops import se2
from navrl.ops.icp import align
from navrl.ops.icp_options import PAPER, ROBUST, IcpOptions
from navrl.ops.icp_quality import align_from_prior


def accepted(transform: Tensor, scans: tuple[Tensor, ...], options: IcpOptions) -> Tensor:
    """Return whether the quality meets the default thresholds of ICPAlign."""
    return quality_score(transform, scans, options) >= 1.0


def print_rows(name: str, pairs: ScanPairs) -> None:
    """Print one row of a Markdown table for each option."""
    scans = (*pairs.source[1:], *pairs.target[1:])
    noise = torch.randn(pairs.T_target_source.shape, generator=torch.Generator().manual_seed(0))
    prior = se2.compose(pairs.T_target_source, ODOMETRY * noise)
    for label, options in (("paper", PAPER), ("robust", ROBUST)):
        plain = align(*scans, options)
        for row, result in (
            (label, plain),
            (f"{label}, prior", align_from_prior(prior, *scans, options, 0.0)),
            (f"{label}, prior that holds", align_from_prior(prior, *scans, options)),
        ):
            position, rotation = errors(result.transform, pairs.T_target_source)
            is_wrong = (position > 0.03) | (rotation > 2.0)
            is_good = accepted(result.transform, scans, options)
            kept = (is_wrong & is_good).sum() / is_good.sum().clamp(min=1)
            shares = [(position > 0.03), (rotation > 2.0), result.converged, is_good]
            cells = [f"{100.0 * float(part.float().mean()):.1f}" for part in shares]
            print("|", " | ".join([name, row, *cells, f"{100.0 * float(kept):.1f}"]), "|")


if __name__ == "__main__":
    rooms = sample_scan_pairs(500, seed=2, beams_per_point=8)
    turned = rooms.T_target_source[:, 2].abs() > torch.tensor(8.0).deg2rad()
    turning = ScanPairs(
        *(type(scan)(*(part[turned] for part in scan)) for scan in rooms[:2]),
        rooms.T_target_source[turned],
    )
    for title, sample in (
        ("rooms", rooms),
        ("rooms, turning > 8 deg", turning),
        ("corridor, one walker", corridor_pairs(200)),
        ("corridor, person standing", corridor_pairs(200, walked=0.0)),
    ):
        print_rows(title, sample)
