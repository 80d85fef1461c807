"""Whether a window can be opened: PyBullet ends the whole process if it cannot."""

import ctypes
import os
import sys


def require_display() -> None:
    """Return if there is a display that answers.

    Raises:
        RuntimeError: there is none.
    """
    if not sys.platform.startswith("linux"):
        return
    name = os.environ.get("DISPLAY", "")
    if not name:
        raise RuntimeError(
            "gui=true needs a display, and DISPLAY is not set: use gui=false, "
            "or run the command under xvfb-run"
        )
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError as error:
        raise RuntimeError("gui=true needs the X11 library, libX11.so.6 is missing") from error
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)
    if not display:
        raise RuntimeError(f"gui=true needs a display, and none answers at DISPLAY={name}")
    x11.XCloseDisplay(display)
