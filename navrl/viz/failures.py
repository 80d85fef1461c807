"""Gallery of failed episodes."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from navrl.evaluation.recording import Recording
from navrl.evaluation.recording_checks import REPLAY
from navrl.viz.animation import OUTCOME_WORDS, episode_name
from navrl.viz.legend import add_legend
from navrl.viz.scene import draw_scene
from navrl.viz.style import plain_text, save_figure, style

_TITLE_LETTERS = 46  # that fit in a panel's width


def save_failures(
    recordings: Sequence[Recording],
    file: str | Path,
    limit: int = 12,
    policies: Sequence[str | None] | None = None,
    counts: tuple[int, int] | None = None,
) -> Path:
    """Draw the end of every failed episode, with the robot's trajectory.

    Args:
        recordings: Episodes; successes and replays of logs are skipped.
        file: ``.png``, ``.svg`` or ``.pdf``.
        limit: Maximum number of scenes; the first ones are drawn, and the headline has the total.
        policies: Policy of each recording, ``None`` if unknown.
        counts: Numbers of failed and played episodes, recorded or not; ``None`` if unknown.

    Returns:
        The file.

    Raises:
        ValueError: If no episode failed, or ``limit`` is not positive.
    """
    if limit < 1:
        raise ValueError(f"limit={limit}: must be at least 1")
    policies = [None] * len(recordings) if policies is None else policies
    pairs = zip(recordings, policies, strict=True)
    failed = [pair for pair in pairs if pair[0].outcome not in ("success", REPLAY)]
    if not failed:
        raise ValueError(f"recordings: none of {len(recordings)} failed, must have at least one")
    shown = failed[:limit]
    columns = len(shown) if len(shown) <= 4 else min(4, math.ceil(math.sqrt(len(shown))))
    rows = -(-len(shown) // columns)
    with style():
        figure = Figure((max(3.0 * columns, 6.0), 3.5 * rows + 1.0), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False)
        for axes, (recording, policy) in zip(panels.flat, shown, strict=False):
            draw_scene(axes, recording, recording.num_steps, descriptors=False)
            axes.set_title(_title(recording, policy), fontsize=8)
        for axes in panels.flat[len(shown) :]:
            axes.set_visible(False)
        add_legend(figure, shown[0][0], columns=3, attention=(), descriptors=False)
        figure.suptitle(_headline(len(shown), len(failed), counts), fontsize=10)
        return save_figure(figure, file)


def _headline(shown: int, recorded: int, counts: tuple[int, int] | None) -> str:
    """Return the number of failures, and of played episodes if known."""
    if counts is None:
        some = f"{shown} of {recorded}" if shown < recorded else f"{recorded}"
        return f"{some} failed episode{'s' * (recorded != 1)}"
    lost, played = counts
    some = f"; {shown} of them shown" if shown < lost else ""
    return f"{lost:,} of {played:,} episodes failed{some}"


def _title(recording: Recording, policy: str | None) -> str:
    seconds = recording.num_steps * recording.time_step_s
    ending = OUTCOME_WORDS.get(recording.outcome, recording.outcome)
    lines = [episode_name(recording), f"{ending}, {seconds:.1f} s"]
    lines = lines if policy is None else [policy, *lines]
    return plain_text("\n".join(textwrap.fill(line, _TITLE_LETTERS) for line in lines))
