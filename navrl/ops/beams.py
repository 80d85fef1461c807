"""Lidar constants and types shared by the kernels and the torch reference."""

from typing import Literal

HIT_MARGIN = 1e-3  # m; noisy hits are clamped this far below the maximum range

# A reading closer to the maximum range than this is not a return, so that float rounding of a
# maximum range is never treated as an obstacle.
RETURN_MARGIN_M = 1e-4

Bearing = Literal["bin", "beam"]
"""Whether a pooled point lies at the center of its bin or along its nearest beam."""

# A point on the border of two sectors belongs to both; the tolerance covers float32 rounding.
SECTOR_TOLERANCE_RAD = 1e-6


def first_beam(part: int, num_parts: int, num_beams: int) -> int:
    """Return the first beam that a spinning lidar measures in one of the parts of its sweep.

    Beam j is measured in the part nearest to its time, which is j / (num_beams - 1) of the sweep
    from the first to the last part.

    Args:
        part: Index of the part, 0 .. num_parts; the last one has no beams.
        num_parts: Number of parts of the sweep, at least 1.
        num_beams: Number of beams.

    Returns:
        The index, as a whole number.

    Example:
        >>> [first_beam(part, 3, 9) for part in range(4)]
        [0, 2, 6, 9]
    """
    if part >= num_parts:
        return num_beams
    if part == 0:
        return 0
    double = 2 * (num_parts - 1)
    return ((2 * part - 1) * (num_beams - 1) + double - 1) // double
