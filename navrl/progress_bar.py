"""Progress bar with a low refresh rate in log files."""

from __future__ import annotations

import sys

from tqdm import tqdm

_TERMINAL_INTERVAL_S = 0.1
_LOG_INTERVAL_S = 30.0  # each refresh adds a line to a log file


def progress_bar(total: int, unit: str, *, initial: int = 0, enabled: bool = True) -> tqdm:
    """Return a progress bar with rate and remaining time on standard error.

    Args:
        total: Total number of units.
        unit: Name of a unit.
        initial: Number of units already done.
        enabled: Whether to show the bar.
    """
    interval = _TERMINAL_INTERVAL_S if sys.stderr.isatty() else _LOG_INTERVAL_S
    return tqdm(
        total=total,
        initial=initial,
        unit=unit,
        unit_scale=total > 10_000,
        mininterval=interval,
        disable=not enabled,
    )
