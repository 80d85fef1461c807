"""Estimates of the time that the first compilation of the kernels takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

EXPECTED_S = {  # s, among the lowest of up to 240 measurements, on a core of a cloud server
    "add_range_noise_kernel": 0.6,
    "align_kernel": 9.5,
    "cast_rays_kernel": 1.8,
    "maneuver_kernel": 3.9,
    "min_pool_kernel": 0.6,
    "place_pedestrians_kernel": 0.9,
    "plan_kernel": 1.9,
    "points_at_kernel": 0.3,
    "project_kernel": 0.6,
    "scan_worlds_kernel": 1.6,
    "step_worlds_kernel": 3.8,
    "tagd_kernel": 1.8,
    "transform_points_kernel": 0.2,
}


class CompileProgress:
    """Progress of a process that compiles kernels one after the other.

    Args:
        clock: Returns the time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without a compiled kernel."""
        self._clock = clock
        self._name: str | None = None
        self._start = 0.0
        self._spent_s, self._expected_s = 0.0, 0.0

    def begin(self, name: str, directory: Path) -> str:
        """Return a message on the kernel that is compiled next, with the remaining time.

        The remaining time counts all kernels that are not in the cache, although a command may not
        need all of them. It follows the speed of the compilations so far.

        Args:
            name: Name of the kernel.
            directory: Folder of the cached kernels.
        """
        self._name, self._start = name, self._clock()
        message = f"compiling {name} once"
        if name in EXPECTED_S:
            left = {name} | {one for one in EXPECTED_S if not is_cached(one, directory)}
            pace = self._spent_s / self._expected_s if self._expected_s else 1.0
            own, whole = pace * EXPECTED_S[name], pace * sum(EXPECTED_S[one] for one in left)
            message += f", about {own:.0f} s; at most {whole:.0f} s for {len(left)} kernels"
        return f"{message}; cached in {directory}"

    def end(self) -> None:
        """Note that the kernel of the last :meth:`begin` is compiled."""
        if self._name in EXPECTED_S:
            self._spent_s += self._clock() - self._start
            self._expected_s += EXPECTED_S[self._name]
        self._name = None


def is_cached(name: str, directory: Path) -> bool:
    """Return whether the cache has code of a kernel."""
    return any(directory.rglob(f"*.{name}-*.nbc"))


PROGRESS = CompileProgress()
