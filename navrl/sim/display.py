"""Check for a display, without which PyBullet's GUI would end the whole process."""

import ctypes
import os
import sys


def require_display() -> None:
    """Check that there is a display that responds.

    Raises:
        RuntimeError: If there is none.
    """
    if not sys.platform.startswith("linux"):
        return
    name = os.environ.get("DISPLAY", "")
    if not name:
        raise RuntimeError(
            "gui=true: needs a display, but DISPLAY is not set; use gui=false, "
            "or run the command with xvfb-run"
        )
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError as error:
        raise RuntimeError("gui=true: needs the X11 library, libX11.so.6 is missing") from error
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)
    if not display:
        raise RuntimeError(f"gui=true: needs a display, but none responds at DISPLAY={name}")
    x11.XCloseDisplay(display)
