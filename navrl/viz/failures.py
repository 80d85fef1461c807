"""A gallery of how episodes were lost."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from navrl.evaluation.recording import Recording
from navrl.viz.animation import OUTCOME_WORDS
from navrl.viz.legend import add_legend
from navrl.viz.scene import draw_scene
from navrl.viz.style import save_figure, style


def save_failures(recordings: Sequence[Recording], file: str | Path, limit: int = 12) -> Path:
    """Draw the end of every episode that was no success, with the way to it.

    Args:
        recordings: Episodes; successes are passed over.
        file: ``.png``, ``.svg`` or ``.pdf``.
        limit: Of scenes; the first ones are drawn, and the headline tells how many there are.

    Returns:
        The file.

    Raises:
        ValueError: If no episode failed, or ``limit`` is not positive.
    """
    if limit < 1:
        raise ValueError(f"limit={limit}: must be at least 1")
    failed = [recording for recording in recordings if recording.outcome != "success"]
    if not failed:
        raise ValueError(f"recordings: none of {len(recordings)} failed, there is nothing to show")
    shown = failed[:limit]
    columns = len(shown) if len(shown) <= 4 else min(4, math.ceil(math.sqrt(len(shown))))
    rows = -(-len(shown) // columns)
    with style():
        figure = Figure((max(3.0 * columns, 6.0), 3.2 * rows + 0.9), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False)
        for axes, recording in zip(panels.flat, shown, strict=False):
            draw_scene(axes, recording, recording.num_steps, descriptors=False)
            axes.set_title(_title(recording), fontsize=8)
        for axes in panels.flat[len(shown) :]:
            axes.set_visible(False)
        add_legend(figure, shown[0], columns=3, attention=(), descriptors=False)
        figure.suptitle(
            f"{len(failed)} of {len(recordings)} recorded episodes were lost"
            + (f"; the first {len(shown)}" if len(shown) < len(failed) else ""),
            fontsize=10,
        )
        return save_figure(figure, file)


def _title(recording: Recording) -> str:
    scenario = json.loads(recording.scenario)
    seconds = recording.num_steps * recording.time_step_s
    ending = OUTCOME_WORDS.get(recording.outcome, recording.outcome)
    return (
        f"{scenario['suite']} #{scenario['index']}, {scenario['kind']}\n{ending}, {seconds:.1f} s"
    )
