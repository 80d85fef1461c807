"""Connection to a PyBullet client."""

from __future__ import annotations

import contextlib
import functools
import time
from typing import Any

from navrl.sim.display import require_display

try:
    import pybullet
except ImportError as error:
    raise ImportError(
        "BulletSimulator needs PyBullet, which is not installed: pip install pybullet"
    ) from error


class Client:
    """Connection to PyBullet: ``client.f(...)`` is ``pybullet.f(..., physicsClientId=...)``.

    Args:
        is_shown: Whether to open a window.

    Raises:
        RuntimeError: If there is no display, or PyBullet has no more clients.
    """

    def __init__(self, is_shown: bool) -> None:
        if is_shown:
            require_display()
        self.is_shown, self._due = is_shown, 0.0
        try:
            self._id = pybullet.connect(pybullet.GUI if is_shown else pybullet.DIRECT)
        except pybullet.error as error:
            raise RuntimeError(f"PyBullet cannot open a client: {error}") from error
        if self._id < 0:
            raise RuntimeError("PyBullet cannot open a client: too many are open in this process")
        if is_shown:
            self.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0)

    def __getattr__(self, name: str) -> Any:
        value = getattr(pybullet, name)
        if callable(value):
            value = functools.partial(value, physicsClientId=self._id)
        setattr(self, name, value)
        return value

    @contextlib.contextmanager
    def paused_drawing(self):
        """Suspend rendering of the window while bodies are created."""
        if self.is_shown:
            self.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 0)
        yield
        if self.is_shown:
            self.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 1)

    def wait_for_real_time(self, duration: float) -> None:
        """Wait until ``duration`` s after the last call, if the window is shown."""
        if self.is_shown:
            now = time.monotonic()
            self._due = max(self._due + duration, now - duration)
            time.sleep(max(self._due - now, 0.0))

    def close(self) -> None:
        """Disconnect and free the memory of the client."""
        if pybullet.isConnected(self._id):
            pybullet.disconnect(self._id)
