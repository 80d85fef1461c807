"""Pictures of ``navrl-plot``: find the files, draw them, write all formats.

All functions accept folders or files as ``sources`` and search folders recursively.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from navrl.evaluation.recording import Recording
from navrl.evaluation.stored import find_evaluations
from navrl.viz.animation import save_gif, save_png, save_strip
from navrl.viz.curves import plot_curves
from navrl.viz.failures import save_failures
from navrl.viz.origins import count_failures, policy_of
from navrl.viz.rates import plot_rates
from navrl.viz.rerun_log import save_rrd
from navrl.viz.robustness import plot_robustness
from navrl.viz.tagd import save_tagd
from navrl.viz.video import save_mp4

FORMATS = (".png", ".svg", ".pdf")


def find_files(sources: Iterable[str | Path], *patterns: str) -> list[Path]:
    """Return files in and below some folders; a file is returned itself.

    Raises:
        ValueError: If a source does not exist, or no file is found.
    """
    sources = [Path(source) for source in sources]
    for source in sources:
        if not source.exists():
            raise ValueError(f"source={source}: no such file or folder")
    found = [file for source in sources for file in _below(source, patterns)]
    if not found:
        where, what = ", ".join(map(str, sources)), " or ".join(patterns)
        raise ValueError(f"source={where}: no {what} there")
    return list(dict.fromkeys(found))


def find_episode(sources: Sequence[str | Path]) -> Path:
    """Return the first recorded episode in and below a source.

    Raises:
        ValueError: If there are several sources, since only one can be drawn.
    """
    if len(sources) > 1:
        raise ValueError(f"source=[{', '.join(map(str, sources))}]: must be one, of one episode")
    return find_files(sources, "*.npz")[0]


def _episode(sources: Sequence[str | Path]) -> tuple[Recording, str | None]:
    """Return the recording of :func:`find_episode` and its policy, if known."""
    file = find_episode(sources)
    return Recording.load(file), policy_of(file)


def _below(source: Path, patterns: Sequence[str]) -> list[Path]:
    if source.is_file():
        return [source]
    return sorted(file for pattern in patterns for file in source.rglob(pattern))


def find_recordings(sources: Iterable[str | Path]) -> list[Recording]:
    """Return the recorded episodes in and below some folders, in the order of their paths."""
    return [Recording.load(file) for file in find_files(sources, "*.npz")]


def curves(sources: Sequence[str], out: Path, formats: Sequence[str] = FORMATS) -> list[Path]:
    """Draw learning curves of runs or bundles; ``NAME_seed_K`` are seeds of one setting."""
    logs = find_files(sources, "metrics.csv", "curve.csv")
    labels = [re.sub(r"_seed_\d+", "", log.resolve().parent.name) for log in logs]
    return _each_format(
        lambda file: plot_curves(logs, file, labels, [file.suffix])[0], out, formats
    )


def rates(sources: Sequence[str], out: Path, formats: Sequence[str] = FORMATS) -> list[Path]:
    """Draw success over speed and number of pedestrians, from the evaluations of a sweep."""
    evaluations = find_evaluations(sources)
    return _each_format(lambda file: plot_rates(evaluations, file), out, formats)


def robustness(sources: Sequence[str], out: Path, formats: Sequence[str] = FORMATS) -> list[Path]:
    """Draw success under each perturbation, from the evaluations of a sweep."""
    evaluations = find_evaluations(sources)
    return _each_format(lambda file: plot_robustness(evaluations, file), out, formats)


def attention(
    sources: Sequence[str], out: Path, formats: Sequence[str] = FORMATS, step: int | None = None
) -> list[Path]:
    """Draw a scene with spatial attention on sectors and temporal attention on descriptors."""
    recording, policy = _episode(sources)
    return _each_format(lambda file: save_png(recording, file, step, policy), out, formats)


def tagd(
    sources: Sequence[str],
    out: Path,
    formats: Sequence[str] = FORMATS,
    step: int | None = None,
    group_radius: float = 0.25,
) -> list[Path]:
    """Draw the computation of descriptors from two scans in five steps."""
    recording, policy = _episode(sources)
    return _each_format(
        lambda file: save_tagd(recording, file, step, group_radius, policy), out, formats
    )


def strip(
    sources: Sequence[str], out: Path, formats: Sequence[str] = FORMATS, count: int = 6
) -> list[Path]:
    """Draw scenes of an episode side by side."""
    recording, policy = _episode(sources)
    return _each_format(lambda file: save_strip(recording, file, count, policy), out, formats)


def failures(
    sources: Sequence[str], out: Path, formats: Sequence[str] = FORMATS, limit: int = 12
) -> list[Path]:
    """Draw the last scenes of failed episodes."""
    episodes = find_files(sources, "*.npz")
    recordings, policies = find_recordings(episodes), [policy_of(file) for file in episodes]
    counts = count_failures(episodes)
    return _each_format(
        lambda file: save_failures(recordings, file, limit, policies, counts), out, formats
    )


def gif(sources: Sequence[str], out: Path, frames_per_s: float | None = None) -> list[Path]:
    """Write an episode as GIF."""
    recording, policy = _episode(sources)
    return [save_gif(recording, out.with_suffix(".gif"), frames_per_s, policy)]


def mp4(sources: Sequence[str], out: Path, frames_per_s: float | None = None) -> list[Path]:
    """Write an episode as MP4; needs the program ffmpeg."""
    recording, policy = _episode(sources)
    return [save_mp4(recording, out.with_suffix(".mp4"), frames_per_s, policy)]


def rerun(sources: Sequence[str], out: Path) -> list[Path]:
    """Write each episode for the viewer of rerun: ``out.rrd``, or files below ``out``."""
    files = find_files(sources, "*.npz")
    if len(files) == 1:
        return [_rrd(files[0], out.with_name(out.name + ".rrd"))]
    top = os.path.commonpath([file.resolve().parent for file in files])
    below = [file.resolve().relative_to(top).with_suffix(".rrd") for file in files]
    return [_rrd(file, out / place) for file, place in zip(files, below, strict=True)]


def _rrd(file: Path, out: Path) -> Path:
    return save_rrd(Recording.load(file), out, f"{file.resolve().parent.name}/{file.stem}")


def _each_format(draw: Callable[[Path], Path], out: Path, formats: Sequence[str]) -> list[Path]:
    unknown = [suffix for suffix in formats if suffix not in FORMATS]
    if unknown or not formats:
        raise ValueError(f"formats={list(formats)}: must be some of {', '.join(FORMATS)}")
    return [draw(out.with_name(out.name + suffix)) for suffix in formats]
