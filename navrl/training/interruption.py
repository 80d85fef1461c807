"""Signals that ask a training to end: noted, so that the trainer can save first."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
_LAG_S = 1.0  # s between the end of a worker and this process's own copy of the same signal


class TrainingStoppedError(Exception):
    """A signal ended the training, which was saved before.

    Args:
        signal_number: The signal.
        done: How much was trained.
        run: Run folder.
    """

    def __init__(self, signal_number: signal.Signals, done: str, run: Path) -> None:
        super().__init__(
            f"stopped by {signal_number.name} after {done}; saved, "
            f"navrl-train resume={run} continues"
        )
        self.signal_number = signal_number


class StopRequested(BaseException):
    """A signal asks to end; not an ``Exception``, so that no handler of errors takes it."""


class StopSignals:
    """Context in which SIGTERM, SIGINT and SIGHUP set a flag instead of ending the process.

    A second SIGINT raises ``KeyboardInterrupt``, for a user who cannot wait for the checkpoint.
    A signal that is ignored when the context begins, as ``nohup`` does with SIGHUP, stays ignored.
    Outside of the main thread, where Python allows no handlers, nothing is changed.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None
        self._is_immediate = False
        self._before: dict[signal.Signals, object] = {}

    def __enter__(self) -> StopSignals:
        self._before = {number: signal.getsignal(number) for number in _SIGNALS}
        self.install()
        return self

    def __exit__(self, *error: object) -> None:
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                signal.signal(number, handler)

    def install(self) -> None:
        """Set the handlers, again where a library has set its own, as Ray does."""
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                if handler is not signal.SIG_IGN:
                    signal.signal(number, self._handle)

    @contextmanager
    def immediate(self, enabled: bool = True) -> Iterator[None]:
        """Let a signal raise :class:`StopRequested` within the block, if ``enabled``."""
        self._is_immediate = enabled
        try:
            if enabled:
                self.check()
            yield
        finally:
            self._is_immediate = False

    def check(self) -> None:
        """Raise :class:`StopRequested` if a signal came."""
        if self.received is not None:
            raise StopRequested

    def arrives(self) -> bool:
        """Return whether a signal came or comes within a second.

        A signal to the whole process group may reach a worker before it reaches this process.
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
    """Block SIGINT and SIGHUP for processes started in the block, which inherit that.

    A terminal sends both to all processes of a command; the trainer alone must answer. It gets a
    signal that comes in the meantime when the block ends.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
