"""An episode as MP4, where the optional encoder is installed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navrl.evaluation.recording import Recording
from navrl.viz.animation import render_frames

_HOLD_S = 1.5  # s for which the last frame stays longer


def save_mp4(recording: Recording, file: str | Path, fps: float | None = None) -> Path:
    """Draw an episode as a film in H.264, which browsers and slides play.

    Args:
        recording: The episode.
        file: ``.mp4``; missing folders are made.
        fps: Frames, which are steps, a second; as fast as it was if ``None``.

    Returns:
        The file.

    Raises:
        ImportError: If imageio-ffmpeg is not installed.
        ValueError: If ``fps`` is not within 0 to 50, or the suffix is not ``.mp4``.
    """
    file, fps = Path(file), 1.0 / recording.time_step_s if fps is None else fps
    if file.suffix != ".mp4":
        raise ValueError(f"file={file}: must end in .mp4")
    if not 0 < fps <= 50:
        raise ValueError(f"fps={fps}: must be above 0 and at most 50")
    encoder = _encoder()
    frames = [_even(frame) for frame in render_frames(recording)]
    frames += [frames[-1]] * round(_HOLD_S * fps)
    height, width = frames[0].shape[:2]
    file.parent.mkdir(parents=True, exist_ok=True)
    writer = encoder.write_frames(
        str(file), (width, height), fps=fps, quality=8, macro_block_size=2
    )
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()
    return file


def _even(frame: np.ndarray) -> np.ndarray:
    """Pad to even sides, as H.264 needs them, by repeating the border."""
    height, width = frame.shape[:2]
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _encoder():
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ImportError("MP4 needs imageio-ffmpeg: pip install 'navrl[video]'") from error
    return imageio_ffmpeg
