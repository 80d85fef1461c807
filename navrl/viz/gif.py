"""Compact GIF files of drawings with one shared palette."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from navrl.files import replacing

_COLORS, _EXACT = 128, 64


def write_gif(
    frames: Sequence[np.ndarray], file: str | Path, frame_s: float, hold_s: float = 0.0
) -> Path:
    """Write an endlessly repeating animation.

    Args:
        frames: Images ``[H, W, 3]`` uint8 of one size.
        file: ``.gif``; missing folders are created.
        frame_s: Duration of each frame, s, in steps of 0.01 s.
        hold_s: Additional duration of the last frame, s.

    Returns:
        The file.
    """
    file = Path(file)
    palette = _shared_palette(frames)
    images = [_indexed(frame, palette) for frame in frames]
    duration = [round(1000 * frame_s)] * len(images)
    duration[-1] += round(1000 * hold_s)
    with replacing(file) as stream:
        images[0].save(
            stream,
            format="GIF",
            save_all=True,
            append_images=images[1:],
            duration=duration,
            loop=0,
            optimize=True,  # unchanged pixels become transparent: less than half the size
        )
    return file


def _shared_palette(frames: Sequence[np.ndarray]) -> np.ndarray:
    """Return the palette ``[C, 3]`` uint8 of all frames, shared to avoid flicker.

    The most frequent colors are exact, so that flat areas and the legend match; the others, from
    antialiasing at edges, share the remaining entries.
    """
    chosen = np.unique(np.linspace(0, len(frames) - 1, 5).astype(int))
    pixels = np.concatenate([frames[i].reshape(-1, 3) for i in chosen])
    colors, index, count = np.unique(_packed(pixels), return_inverse=True, return_counts=True)
    kept = np.argsort(-count, kind="stable")[:_EXACT]
    palette = (colors[kept, None] >> np.array([16, 8, 0], dtype=np.uint32)) & 255
    rest = pixels[~np.isin(index, kept)]
    if len(rest):
        shared = Image.fromarray(rest[None]).quantize(_COLORS - len(kept)).getpalette()
        palette = np.concatenate([palette, np.reshape(shared, (-1, 3))])
    return palette[:_COLORS].astype(np.uint8)


def _indexed(frame: np.ndarray, palette: np.ndarray) -> Image.Image:
    """Map each pixel to the nearest color; Pillow's mapping misses some exact colors."""
    packed = _packed(frame.reshape(-1, 3))
    _, first, index = np.unique(packed, return_index=True, return_inverse=True)
    colors, offered = frame.reshape(-1, 3)[first].astype(np.float32), palette.astype(np.float32)
    # |c - p|^2 without |c|^2, which does not depend on p; exact: integers below 2^24.
    distance = np.square(offered).sum(axis=-1) - 2 * colors @ offered.T
    nearest = distance.argmin(axis=-1).astype(np.uint8)
    image = Image.fromarray(nearest[index].reshape(frame.shape[:2]), mode="P")
    image.putpalette(palette.ravel().tolist())
    return image


def _packed(pixels: np.ndarray) -> np.ndarray:
    return pixels.astype(np.uint32) @ np.array([65536, 256, 1], dtype=np.uint32)
