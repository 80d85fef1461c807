"""Resampling of the scans of any lidar to the beams of a policy, in NumPy."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike

from navrl.checks import checked_numbers
from navrl.ops import scan_adapter
from navrl.ops.scan_layout import ScanLayout
from navrl.ops.scanner import BeamState, Scanner
from navrl.sim import Lidar


class AdaptedScan(NamedTuple):
    """Result of :func:`adapt_scan`, for the N beams of a policy's lidar."""

    ranges: np.ndarray
    """``[N]`` float32 m as :meth:`navrl.deploy.PolicyRunner.act` reads them, by REP 117: +inf is
    free, -inf too near, and NaN not seen."""
    states: np.ndarray
    """``[N]`` int64, codes of :class:`BeamState`."""
    distances: np.ndarray
    """``[N]`` float32 m, as ``ranges``, but too near has the lidar's smallest distance."""


def adapt_scan(
    ranges: ArrayLike, scanner: Scanner, lidar: Lidar, scan_motion: ArrayLike | None = None
) -> AdaptedScan:
    """Resample a scan to the beams of a policy's lidar, by bearing.

    Args:
        ranges: ``[M]`` m, any number of beams.
        scanner: Angles, mount and readings of the robot's lidar.
        lidar: Lidar of the policy, e.g. ``load_bundle(folder).build("lidar")``.
        scan_motion: ``[2, 3]`` (x, y, yaw) m and rad of the robot at the times of the scan's first
            and last beam, in its present frame, from odometry; the result is then that of a scan
            measured now. None for a robot at rest.

    Returns:
        The scan of the policy's beams.

    Raises:
        ValueError: If a shape is wrong, or if the beams of the scan exceed a full circle.

    Example:
        >>> scanner = Scanner(angle_min=-np.pi, range_max=12.0)  # 360 beams, beam 0 behind
        >>> scan = adapt_scan(np.full(360, 2.0), scanner, Lidar(num_beams=1440))
        >>> scan.ranges.shape, float(scan.ranges[0])
        ((1440,), 2.0)
    """
    readings = checked_numbers("ranges", ranges, "[beams] numbers (m)")
    if readings.ndim != 1:
        raise ValueError(f"ranges.shape={list(readings.shape)}: must be [beams]")
    motion = None
    if scan_motion is not None:
        motion = torch.tensor(checked_numbers("scan_motion", scan_motion, "[2, 3] finite numbers"))
        if not motion.isfinite().all():
            raise ValueError("scan_motion: must be finite")
    target = ScanLayout(
        lidar.num_beams, None, 1, lidar.angle_min, lidar.angle_increment, lidar.mount
    )
    scan = scan_adapter.adapt_scan(torch.tensor(readings), scanner, target, motion)
    distances, states = scan.ranges.numpy(), scan.states.numpy()
    reported = np.where(states == BeamState.TOO_NEAR, np.float32(-np.inf), distances)
    return AdaptedScan(reported, states, distances)


def load_scanner(name: str = "any", **changes: object) -> Scanner:
    """Return a lidar of the configuration group ``scanner``.

    Args:
        name: ``any``, ``rplidar_a1``, ``utm_30lx``, ...; the files in ``conf/scanner``.
        changes: Arguments of :class:`Scanner` with other values, e.g. ``mount``.

    Raises:
        ValueError: If there is no such lidar, or a change is invalid; the message names it.

    Example:
        >>> load_scanner("rplidar_a1", mount=(0.1, 0.0, np.pi)).range_max
        12.0
    """
    from navrl.config import compose, did_you_mean, instantiate, options

    if name not in options("scanner"):
        raise ValueError(f"scanner={name!r}: must be one of {', '.join(options('scanner'))}")
    scanner = instantiate(compose(None, [f"+scanner={name}"]).scanner)
    known = [each.name for each in fields(scanner)]
    for key, value in changes.items():
        if key not in known:
            near = did_you_mean(key, known)
            raise ValueError(f"{key}={value!r}: must be one of {', '.join(known)}{near}")
    return replace(scanner, **changes)
