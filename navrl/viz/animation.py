"""Pictures of a recorded episode: single scene, strip of scenes and animation."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from navrl.evaluation.recording import Recording
from navrl.viz.drive import forward_and_turn
from navrl.viz.gif import write_gif
from navrl.viz.legend import add_legend
from navrl.viz.scene import (
    ATTENTIONS,
    attention_scale,
    closest_step,
    draw_scene,
    frame_scene,
    scene_limits,
)
from navrl.viz.style import BLUE, GRAY, VERMILLION, plain_text, save_figure, style

OUTCOME_WORDS = {
    "success": "goal reached",
    "collision_pedestrian": "collision with a pedestrian",
    "collision_static": "collision with a wall",
    "timeout": "time is up",
    "replay": "replay of a log",
}
"""Display texts of outcomes."""

_GIF_INCHES, _GIF_DPI = 4.8, 100  # 480 px wide
_HOLD_S = 1.5  # s, additional duration of the last frame


def episode_name(recording: Recording, policy: str | None = None) -> str:
    """Return suite, index and kind of world, after the name of the policy if it is known."""
    scenario = json.loads(recording.scenario)
    name = f"{scenario['suite']} #{scenario['index']}, {scenario['kind']}"
    return f"{policy}: {name}" if policy else name


def save_png(
    recording: Recording, file: str | Path, step: int | None = None, policy: str | None = None
) -> Path:
    """Draw one step with spatial attention, temporal attention, and all commands.

    Args:
        recording: The episode.
        file: ``.png``, ``.svg`` or ``.pdf``.
        step: Decision to draw, 0 to T - 1; T is the end. The one closest to a pedestrian if
            ``None``.
        policy: Name of the policy, for the headline.

    Returns:
        The file.

    Raises:
        ValueError: If the step or the suffix is none of the above.
    """
    step = closest_step(recording) if step is None else step
    width, height, stacked = _panel_size(recording)
    with style():
        rows, columns = (2, 1) if stacked else (1, 2)
        size = (columns * width + 0.6, rows * height + 2.25)
        figure = Figure(size, layout="constrained")
        scenes, below = figure.subfigures(2, 1, height_ratios=[size[1] - 1.5, 1.5])
        for axes, name in zip(scenes.subplots(rows, columns).flat, ATTENTIONS, strict=True):
            draw_scene(axes, recording, step, [name])
            axes.set_title(f"{name} attention")
            _color_bar(scenes, axes, recording, name, "bottom" if not stacked else "right")
        add_legend(scenes, recording, columns=5)
        title = f"{episode_name(recording, policy)}\n{_headline(recording, step)}"
        figure.suptitle(plain_text(title), fontsize=10)
        _draw_commands(below.subplots(), recording, step)
        return save_figure(figure, file)


def save_strip(
    recording: Recording, file: str | Path, count: int = 6, policy: str | None = None
) -> Path:
    """Draw scenes of an episode at equal time intervals, including the first and the last.

    Args:
        recording: The episode.
        file: ``.png``, ``.svg`` or ``.pdf``.
        count: Number of scenes, at least 2.
        policy: Name of the policy, for the headline.

    Returns:
        The file.

    Raises:
        ValueError: If ``count`` is too small or the suffix is invalid.
    """
    if count < 2:
        raise ValueError(f"count={count}: must be at least 2")
    steps = np.unique(np.linspace(0, recording.num_steps, count).round().astype(int))
    width, height, stacked = _panel_size(recording)
    columns = min(2 if stacked else 3, len(steps))
    rows = -(-len(steps) // columns)
    with style():
        figure = Figure(
            (columns * width * 0.7 + 0.3, rows * height * 0.7 + 0.95), layout="constrained"
        )
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes, step in zip(panels.flat, steps, strict=False):
            draw_scene(axes, recording, int(step), descriptors=False)
            axes.set_title(f"t = {step * recording.time_step_s:.1f} s")
            axes.label_outer()
        for axes in panels.flat[len(steps) :]:
            axes.set_visible(False)
        add_legend(figure, recording, columns=6, attention=(), descriptors=False)
        ending = OUTCOME_WORDS.get(recording.outcome, recording.outcome)
        title = "\n".join([*([policy] if policy else []), f"{episode_name(recording)}: {ending}"])
        figure.suptitle(plain_text(title), fontsize=10)
        return save_figure(figure, file)


def save_gif(
    recording: Recording, file: str | Path, fps: float | None = None, policy: str | None = None
) -> Path:
    """Draw an episode as an animation about 480 px wide.

    Args:
        recording: The episode.
        file: ``.gif``.
        fps: Frames (steps) per second; real time if ``None``.
        policy: Name of the policy, for the headline.

    Returns:
        The file.

    Raises:
        ValueError: If ``fps`` is not within 0 to 50, or the suffix is not ``.gif``.
    """
    file, fps = Path(file), 1.0 / recording.time_step_s if fps is None else fps
    if file.suffix != ".gif":
        raise ValueError(f"file={file}: must end in .gif")
    if not 0 < fps <= 50:
        raise ValueError(f"fps={fps}: must be above 0 and at most 50")
    return write_gif(list(render_frames(recording, policy)), file, 1.0 / fps, _HOLD_S)


def render_frames(recording: Recording, policy: str | None = None) -> Iterator[np.ndarray]:
    """Yield an image ``[H, W, 3]`` uint8 of each of the T + 1 states, all of one size.

    Args:
        recording: The episode.
        policy: Name of the policy, for the headline.
    """
    (left, right), (bottom, top) = scene_limits(recording)
    width = _GIF_INCHES - 0.65
    height = min(width * (top - bottom) / (right - left), 4.8)
    size = _GIF_INCHES, height + 2.7
    with style():
        figure = Figure(size, dpi=_GIF_DPI)
        canvas = FigureCanvasAgg(figure)
        place = _share(size, 0.5, 2.2, width, height)
        commands = figure.add_axes(_share(size, 0.5, 0.45, width - 0.35, 0.75))
        frame_scene(figure.add_axes(place), recording)
        caption = figure.add_subfigure(figure.add_gridspec(1, 1)[0], facecolor="none")
        add_legend(caption, recording, columns=3, loc="lower center")
        caption.legends[0].set_bbox_to_anchor((0.5, 1.22 / size[1]), caption.transSubfigure)
        _draw_commands(commands, recording, None)
        name = plain_text(episode_name(recording, policy))
        figure.text(0.5, 1.0 - 0.06 / size[1], name, ha="center", va="top", fontsize=9)
        canvas.draw()
        still = canvas.copy_from_bbox(figure.bbox)  # static background of all frames
        scene = figure.add_axes(place)
        now = commands.axvline(0.0, color=GRAY, linewidth=1.0)
        for step in range(recording.num_steps + 1):
            scene.clear()
            draw_scene(scene, recording, step, list(ATTENTIONS))
            scene.set_axis_off()
            scene.set_title(_headline(recording, step))
            now.set_xdata([step * recording.time_step_s] * 2)
            canvas.restore_region(still)
            figure.draw_artist(scene)
            commands.draw_artist(now)
            yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


# --- parts ---------------------------------------------------------------------------------------


def _panel_size(recording: Recording) -> tuple[float, float, bool]:
    """Return width and height of a scene in inches, and whether scenes are stacked vertically."""
    (left, right), (bottom, top) = scene_limits(recording)
    ratio = (top - bottom) / (right - left)
    if ratio < 0.6:
        return 6.4, 6.4 * ratio + 0.5, True
    return 4.4, min(4.4 * ratio, 7.0) + 0.5, False


def _headline(recording: Recording, step: int) -> str:
    text = f"t = {step * recording.time_step_s:.1f} s (step {step} of {recording.num_steps})"
    if step == recording.num_steps:
        text += f", {OUTCOME_WORDS.get(recording.outcome, recording.outcome)}"
    return text


def _color_bar(figure: Figure, axes: Axes, recording: Recording, name: str, location: str) -> None:
    scale = attention_scale(recording, name)
    if scale is None:
        axes.text(0.5, 0.5, "not recorded", transform=axes.transAxes, ha="center", color=GRAY)
        return
    bar = figure.colorbar(
        ScalarMappable(scale, ATTENTIONS[name]),
        ax=axes,
        location=location,
        extend="max",
        shrink=0.8,
        aspect=30,
        pad=0.02,
    )
    bar.set_label("weight, all sum to 1")


def _draw_commands(axes: Axes, recording: Recording, step: int | None) -> None:
    """Draw v and w over time as step functions, each on its own axis."""
    edges = np.arange(recording.num_steps + 1) * recording.time_step_s
    turn = axes.twinx()
    turn.grid(False)
    turn.spines["right"].set_visible(True)
    speeds = forward_and_turn(recording).T
    for side, values, color, label in (
        (axes, speeds[0], BLUE, "v in m/s"),
        (turn, speeds[1], VERMILLION, "w in rad/s"),
    ):
        side.stairs(values, edges, baseline=None, color=color, snap=False)
        side.set_ylabel(label, color=color)
        side.tick_params(axis="y", colors=color)
    limit = max(1.0, float(np.abs(speeds[1]).max()))
    axes.set(xlabel="time in s", xlim=(0.0, edges[-1]))
    axes.set_ylim(min(0.0, float(speeds[0].min())) - 0.05, max(1.0, float(speeds[0].max())) + 0.05)
    turn.set_ylim(-1.1 * limit, 1.1 * limit)
    if step is not None:
        axes.axvline(step * recording.time_step_s, color=GRAY, linewidth=1.0)


def _share(size: tuple[float, float], x: float, y: float, width: float, height: float) -> tuple:
    """Convert a rectangle from inches to fractions of the figure."""
    return x / size[0], y / size[1], width / size[0], height / size[1]
