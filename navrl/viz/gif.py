"""Small GIFs of drawings: one palette for all frames, exact where areas are flat."""

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
    """Write an animation that repeats for ever.

    Args:
        frames: Pictures ``[H, W, 3]`` uint8 of one size.
        file: ``.gif``; missing folders are made.
        frame_s: s for which each frame stays; GIF knows hundredths.
        hold_s: s for which the last frame stays longer.

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
            optimize=True,  # what does not change is stored as transparent: less than half the size
        )
    return file


def _shared_palette(frames: Sequence[np.ndarray]) -> np.ndarray:
    """Return ``[C, 3]`` uint8 for all frames, so that nothing flickers.

    The most frequent colors are kept as they are (white stays white, the legend's colors those of
    the scene); the others, from blending at edges, share what is left.
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
    """Map each pixel to the nearest color; Pillow's own mapping misses colors that are there."""
    packed = _packed(frame.reshape(-1, 3))
    _, first, index = np.unique(packed, return_index=True, return_inverse=True)
    colors, offered = frame.reshape(-1, 3)[first].astype(np.float32), palette.astype(np.float32)
    # |c - p|^2 without |c|^2, which is the same for each p; exact: integers below 2^24.
    distance = np.square(offered).sum(axis=-1) - 2 * colors @ offered.T
    nearest = distance.argmin(axis=-1).astype(np.uint8)
    image = Image.fromarray(nearest[index].reshape(frame.shape[:2]), mode="P")
    image.putpalette(palette.ravel().tolist())
    return image


def _packed(pixels: np.ndarray) -> np.ndarray:
    return pixels.astype(np.uint32) @ np.array([65536, 256, 1], dtype=np.uint32)
