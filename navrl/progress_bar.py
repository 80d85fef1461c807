"""Progress bar with few lines in log files, and estimates of the remaining time."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable

from tqdm import tqdm

_WITHOUT_REMAINING = "{l_bar}{bar}| {n_fmt}/{total_fmt} [{elapsed}, {rate_fmt}{postfix}]"
_TERMINAL_INTERVAL_S = 0.1
_LOG_INTERVAL_S = 30.0  # each refresh is a line in a file
# tqdm's own lock has a semaphore, whose tracker starts before a training can shield it from SIGHUP.
tqdm.set_lock(threading.RLock())


def progress_bar(
    total: int,
    unit: str,
    *,
    initial: int = 0,
    enabled: bool = True,
    delay_s: float = 0.0,
    remaining: bool = True,
) -> tqdm:
    """Return a progress bar with rate and remaining time on standard error.

    Args:
        total: Units at the end.
        unit: Name of a unit.
        initial: Units done before.
        enabled: Whether to show the bar.
        delay_s: Time until the bar is shown, s.
        remaining: Whether the bar estimates the remaining time, from its mean rate; False for a
            task whose rate changes, see :class:`RemainingTime`.
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
        bar_format=None if remaining else _WITHOUT_REMAINING,
    )


class RemainingTime:
    """Remaining time of a task, by its progress within the last minutes.

    The first part of a task may be faster or slower than the rest, such as a training before its
    first update; :meth:`restart` excludes it.

    Args:
        window_s: Time whose progress counts, s.
        clock: Returns the time, s.

    Example:
        >>> times = iter([0.0, 10.0])
        >>> remaining = RemainingTime(clock=lambda: next(times))
        >>> remaining.restart(0.5)
        >>> remaining.estimate(0.6)
        40.0
    """

    def __init__(
        self, window_s: float = 600.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start without progress."""
        self._window_s, self._clock = window_s, clock
        self._marks: deque[tuple[float, float]] = deque()

    def restart(self, share: float) -> None:
        """Ignore all progress until now, with ``share`` of the task done."""
        self._marks.clear()
        self._marks.append((self._clock(), share))

    def estimate(self, share: float) -> float:
        """Return the remaining time, s, with ``share`` of the task done; infinite if unknown."""
        now = self._clock()
        self._marks.append((now, share))
        while now - self._marks[0][0] > self._window_s and len(self._marks) > 2:
            self._marks.popleft()
        start, before = self._marks[0]
        if share <= before:
            return math.inf
        return round((1.0 - min(share, 1.0)) * (now - start) / (share - before), 6)


def shown_time(seconds: float) -> str:
    """Return a duration as hours, minutes and seconds; ``?`` if it is infinite.

    Example:
        >>> shown_time(3725.2), shown_time(math.inf)
        ('1:02:05', '?')
    """
    if math.isinf(seconds):
        return "?"
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
