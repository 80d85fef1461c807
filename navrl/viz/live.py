"""Frames of a running episode, all of one size."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from navrl.evaluation.recording import Recording
from navrl.viz.animation import OUTCOME_WORDS, episode_name
from navrl.viz.scene import draw_scene
from navrl.viz.style import plain_text, style

FRAME_PIXELS = 480
"""Height and width of a frame, equal for all worlds, as required for videos of several episodes."""
_DPI = 100


class LiveScene:
    """Renderer of the last step of a running episode."""

    def __init__(self) -> None:
        figure = Figure((FRAME_PIXELS / _DPI, FRAME_PIXELS / _DPI), dpi=_DPI)
        self._canvas = FigureCanvasAgg(figure)
        self._axes = figure.add_axes((0.02, 0.02, 0.96, 0.9))

    def draw(self, recording: Recording) -> np.ndarray:
        """Return an image of the last recorded step.

        Args:
            recording: The episode; its last step is drawn, with trails. A running one has an
                ``outcome`` that is not an end.

        Returns:
            ``[FRAME_PIXELS, FRAME_PIXELS, 3]`` uint8.
        """
        seconds = recording.num_steps * recording.time_step_s
        caption = f"{episode_name(recording)}, t = {seconds:.1f} s"
        if recording.outcome in OUTCOME_WORDS:
            caption += f", {OUTCOME_WORDS[recording.outcome]}"
        with style():
            self._axes.clear()
            draw_scene(self._axes, recording, recording.num_steps)
            self._axes.set_axis_off()
            self._axes.set_title(plain_text(caption))
            self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
