"""Progress bar with few lines in log files."""

from __future__ import annotations

import sys

from tqdm import tqdm

_TERMINAL_INTERVAL_S = 0.1
_LOG_INTERVAL_S = 30.0  # each refresh is a line in a file


def progress_bar(
    total: int, unit: str, *, initial: int = 0, enabled: bool = True, delay_s: float = 0.0
) -> tqdm:
    """Return a progress bar with rate and remaining time on standard error.

    Args:
        total: Units at the end.
        unit: Name of a unit.
        initial: Units done before.
        enabled: Whether to show the bar.
        delay_s: Time until the bar is shown, s.
    """
    interval = _TERMINAL_INTERVAL_S if sys.stderr.isatty() else _LOG_INTERVAL_S
    return tqdm(
        total=total,
        initial=initial,
        unit=unit,
        unit_scale=total > 10_000,
        mininterval=interval,
        disable=not enabled,
        delay=delay_s,
    )
