"""The present moment of a running episode, as frames of one size."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from navrl.evaluation.recording import Recording
from navrl.viz.animation import OUTCOME_WORDS
from navrl.viz.scene import draw_scene
from navrl.viz.style import style

FRAME_PIXELS = 480
"""Height and width of a frame: the same for all worlds, as videos of several episodes need it."""
_DPI = 100


class LiveScene:
    """Drawing of the last moment of an episode that grows."""

    def __init__(self) -> None:
        figure = Figure((FRAME_PIXELS / _DPI, FRAME_PIXELS / _DPI), dpi=_DPI)
        self._canvas = FigureCanvasAgg(figure)
        self._axes = figure.add_axes((0.02, 0.02, 0.96, 0.9))

    def draw(self, recording: Recording) -> np.ndarray:
        """Return the last moment of what was recorded so far.

        Args:
            recording: The episode; its last step is drawn, with trails into its past. A running one
                has an ``outcome`` that is none of an end.

        Returns:
            ``[FRAME_PIXELS, FRAME_PIXELS, 3]`` uint8.
        """
        caption = f"t = {recording.num_steps * recording.time_step_s:.1f} s"
        if recording.outcome in OUTCOME_WORDS:
            caption += f", {OUTCOME_WORDS[recording.outcome]}"
        with style():
            self._axes.clear()
            draw_scene(self._axes, recording, recording.num_steps)
            self._axes.set_axis_off()
            self._axes.set_title(caption)
            self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
