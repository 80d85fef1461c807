"""MP4 videos of episodes by the program ffmpeg."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np

from navrl.evaluation.recording import Recording
from navrl.files import replacing_path
from navrl.viz.animation import render_frames

_HOLD_S = 1.5  # s, additional duration of the last frame


def save_mp4(
    recording: Recording, file: str | Path, fps: float | None = None, policy: str | None = None
) -> Path:
    """Write an episode as an H.264 video, playable in browsers and slides.

    Args:
        recording: The episode.
        file: ``.mp4``; missing folders are created.
        fps: Frames (steps) per second; real time if ``None``.
        policy: Name of the policy, for the headline.

    Returns:
        The file.

    Raises:
        FileNotFoundError: If the program ffmpeg is not on the path.
        OSError: If the disk is full.
        RuntimeError: If ffmpeg fails, with its message.
        ValueError: If ``fps`` is not within 0 to 50, or the suffix is not ``.mp4``.
    """
    file, fps = Path(file), 1.0 / recording.time_step_s if fps is None else fps
    if file.suffix != ".mp4":
        raise ValueError(f"file={file}: must end in .mp4")
    if not 0 < fps <= 50:
        raise ValueError(f"fps={fps}: must be above 0 and at most 50")
    program = shutil.which("ffmpeg")
    if program is None:
        raise FileNotFoundError("MP4 needs the program ffmpeg: install it, e.g. apt install ffmpeg")
    frames = [_even(frame) for frame in render_frames(recording, policy)]
    frames += [frames[-1]] * round(_HOLD_S * fps)
    with replacing_path(file) as fresh:
        _encode(program, np.stack(frames), fps, fresh)
    return file


def _encode(program: str, frames: np.ndarray, fps: float, file: Path) -> None:
    """Send frames [T, height, width, 3] to ffmpeg."""
    _, height, width, _ = frames.shape
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps)]
    h264 = ["-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    command = [program, "-y", "-loglevel", "error", *raw, "-i", "-", *h264, str(file)]
    done = subprocess.run(command, input=frames.tobytes(), capture_output=True, check=False)
    words = done.stderr.decode(errors="replace").strip()
    if os.strerror(errno.ENOSPC) in words:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(file))
    if done.returncode != 0:
        raise RuntimeError(f"ffmpeg could not write {file}: {words}")


def _even(frame: np.ndarray) -> np.ndarray:
    """Pad to even sides, as required by H.264, by repeating the border."""
    height, width = frame.shape[:2]
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
