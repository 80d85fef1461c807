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
