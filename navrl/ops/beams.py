"""Constants and types of lidar beams that kernels and their references share."""

from typing import Literal

HIT_MARGIN = 1e-3  # m; a noisy hit stays this far below the maximum range

# A reading closer to the maximum than this is the maximum: float noise never makes a return.
RETURN_MARGIN_M = 1e-4

Bearing = Literal["bin", "beam"]
"""Whether a pooled point lies at the center of its bin or along its nearest beam."""

# A point on the border of two sectors belongs to both, also in float32.
SECTOR_TOLERANCE_RAD = 1e-6
