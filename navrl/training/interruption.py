"""Handling of stop signals, so that the trainer saves a checkpoint before it ends."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
_LAG_S = 1.0  # s; largest delay of a signal to this process after a worker has ended by it


class TrainingStoppedError(Exception):
    """Error for a training that was saved and ended by a signal.

    Args:
        signal_number: Received signal.
        done: Description of the progress, for the message.
        run: Run folder.
        command: Command that continues; ``None`` for ``navrl-train resume=RUN``.
    """

    def __init__(
        self, signal_number: signal.Signals, done: str, run: Path, command: str | None = None
    ) -> None:
        command = f"navrl-train resume={run}" if command is None else command
        super().__init__(
            f"stopped by {signal_number.name} after {done}; saved, {command} continues"
        )
        self.signal_number = signal_number


class StopRequested(BaseException):
    """Request to end by a signal; not an ``Exception``, so that error handlers do not catch it."""


class StopSignals:
    """Context in which SIGTERM, SIGINT and SIGHUP set a flag instead of ending the process.

    A second SIGINT raises ``KeyboardInterrupt``, for a user who does not wait for the checkpoint.
    A signal that is ignored on entry, such as SIGHUP under ``nohup``, remains ignored. Outside of
    the main thread, where Python does not allow handlers, the context has no effect.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None
        self._is_immediate = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> StopSignals:
        self._before = {number: signal.getsignal(number) for number in _SIGNALS}
        self.install()
        return self

    def __exit__(self, *error: object) -> None:
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                signal.signal(number, handler)

    def install(self) -> None:
        """Set the handlers; repeat this after a library (e.g. Ray) has set its own."""
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                if handler is not signal.SIG_IGN:
                    signal.signal(number, self._handle)

    @contextmanager
    def immediate(self, enabled: bool = True) -> Iterator[None]:
        """Raise :class:`StopRequested` on a signal within the block, if ``enabled``."""
        self._is_immediate = enabled
        try:
            if enabled:
                self.check()
            yield
        finally:
            self._is_immediate = False

    def check(self) -> None:
        """Raise :class:`StopRequested` if a signal was received."""
        if self.received is not None:
            raise StopRequested

    def arrives(self) -> bool:
        """Return whether a signal was received or is received within a second.

        A signal to the process group may reach a worker before it reaches this process.
        """
        deadline = time.monotonic() + _LAG_S
        while self.received is None and time.monotonic() < deadline:
            time.sleep(0.02)
        return self.received is not None

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGINT == self.received:
            raise KeyboardInterrupt
        self.received = self.received or signal.Signals(number)
        if self._is_immediate:
            self._is_immediate = False
            raise StopRequested


@contextmanager
def shielded_children() -> Iterator[None]:
    """Block SIGINT and SIGHUP for processes started in the block, which inherit the mask.

    A terminal sends both signals to all processes of a command, but only the trainer must handle
    them. A signal that arrives during the block is delivered to the trainer at its end.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def shield_resource_tracker() -> None:
    """Start Python's resource tracker now, so that SIGHUP cannot end it.

    The tracker ignores SIGINT and SIGTERM already. If SIGHUP ended it, the names of shared memory
    that it had registered would be reported as unknown.
    """
    with shielded_children():
        resource_tracker.ensure_running()
