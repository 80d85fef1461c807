"""Shared style of all pictures: color-blind-safe colors, fonts for print.

Figures are created without pyplot, so that no display is needed and global matplotlib settings are
not changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from navrl.files import replacing

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
GRAY = "#7F7F7F"
CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
"""Okabe and Ito's palette; yellow is not used for lines, since it is too pale on white."""
MARKERS = "osD^vPX<"
"""Markers of policies; one more than colors, so pairs repeat late."""
_DASHES = ("-", "--", "-.", ":")

SPATIAL_COLORS = LinearSegmentedColormap.from_list("spatial", ["#FFFFFF", SKY, BLUE])
TEMPORAL_COLORS = LinearSegmentedColormap.from_list("temporal", ["#FFF1E8", VERMILLION, "#A01C00"])

_RC = {
    "figure.dpi": 100,
    "lines.linewidth": 1.2,
    "legend.handlelength": 2.2,
    "savefig.dpi": 200,
    "font.size": 8,
    "axes.titlesize": 9,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": matplotlib.cycler(color=CYCLE),
    "svg.fonttype": "none",  # text is stored as text
    "svg.hashsalt": "navrl",  # reproducible files
}


@contextmanager
def style() -> Iterator[None]:
    """Apply the style inside a ``with`` block."""
    with matplotlib.rc_context(_RC):
        yield


def line_look(i: int) -> dict[str, Any]:
    """Return color and dash of the i-th line; repeated colors have other dashes."""
    return {
        "color": CYCLE[i % len(CYCLE)],
        "linestyle": _DASHES[i // len(CYCLE) % len(_DASHES)],
    }


def plain_text(text: str) -> str:
    """Escape a text from a file, so that matplotlib draws dollar signs literally."""
    return text.replace("$", r"\$")


def save_figure(figure: Figure, file: str | Path) -> Path:
    """Write a figure reproducibly: equal figures give equal files.

    Args:
        figure: Figure to write.
        file: Its suffix determines the format; missing folders are created.

    Raises:
        ValueError: If the suffix is neither ``.png``, ``.svg`` nor ``.pdf``.
    """
    file = Path(file)
    undated = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    if file.suffix not in undated:
        raise ValueError(f"file={file}: must end in one of {', '.join(undated)}")
    with replacing(file) as stream:
        figure.savefig(stream, format=file.suffix[1:], metadata=undated[file.suffix])
    return file
