"""Legend of a scene."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import FigureBase
from matplotlib.legend_handler import HandlerPatch
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrow, Patch

from navrl.evaluation.recording import Recording
from navrl.viz.scene import SPATIAL, TEMPORAL
from navrl.viz.style import (
    BLACK,
    GRAY,
    GREEN,
    ORANGE,
    PURPLE,
    SPATIAL_COLORS,
    TEMPORAL_COLORS,
)


def add_legend(
    figure: FigureBase,
    recording: Recording,
    columns: int,
    attention: Sequence[str] = (SPATIAL, TEMPORAL),
    descriptors: bool = True,
    loc: str = "outside lower center",
) -> None:
    """Add a legend for :func:`navrl.viz.scene.draw_scene` below the scenes.

    Args:
        figure: Figure or subfigure.
        recording: The episode; elements without data are omitted.
        columns: Number of columns.
        attention: Kinds of attention that are drawn.
        descriptors: Whether TAGDs are drawn.
        loc: Location, as in matplotlib.
    """
    figure.legend(
        handles=_handles(recording, attention, descriptors),
        handler_map={FancyArrow: ArrowHandler()},
        loc=loc,
        ncols=columns,
        columnspacing=1.2,
    )


def _handles(
    recording: Recording, attention: Sequence[str], descriptors: bool
) -> list[Line2D | Patch]:
    handles = [
        Line2D([], [], color=GRAY, linestyle="--", linewidth=1.0, label="global path"),
        Patch(facecolor="none", edgecolor=GREEN, linewidth=1.2, label="goal"),
        Patch(facecolor=PURPLE, edgecolor=BLACK, linewidth=0.6, label="robot, trajectory"),
        Patch(facecolor=ORANGE, edgecolor=BLACK, linewidth=0.6, label="pedestrian, past 2 s"),
        FancyArrow(0, 0, 1, 0, color=ORANGE, label="velocity, 1 s ahead"),
        Line2D([], [], color=BLACK, linestyle="", marker=".", markersize=3, label="lidar point"),
    ]
    if descriptors and recording.tagd is not None:
        handles.append(FancyArrow(0, 0, 1, 0, color=GREEN, label="TAGD, $c_{t-1}$ to $c_t$"))
    if SPATIAL in attention and recording.spatial_attention is not None:
        handles.append(Patch(color=SPATIAL_COLORS(0.7), label="spatial attention"))
    if TEMPORAL in attention and recording.temporal_attention is not None:
        color = TEMPORAL_COLORS(0.6)
        handles.append(Line2D([], [], color=color, linewidth=2, label="temporal attention"))
    return handles


class ArrowHandler(HandlerPatch):
    """Legend handler that draws arrows."""

    def create_artists(self, legend, handle, x, y, width, height, fontsize, transform):
        arrow = FancyArrow(
            x,
            y + height / 2,
            width,
            0,
            length_includes_head=True,
            head_width=height * 0.8,
            head_length=height * 0.8,
            width=height * 0.15,
        )
        self.update_prop(arrow, handle, legend)
        arrow.set_transform(transform)
        return [arrow]
