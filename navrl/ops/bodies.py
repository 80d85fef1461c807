"""Codes of obstacles and of the bodies of pedestrians, shared by kernels and simulators."""

BODY_BOX, BODY_DISC, BODY_LEGS = range(3)
BODY_HEIGHT_M = 1.8
"""Height of a pedestrian, m; obstacles that begin below are in the way."""
BODIES = ("box", "disc", "legs")
"""Names of the codes."""

SEEN, TOUCHED = 1, 2  # bits: the lidar's plane meets an obstacle; the robot's hull can touch it

STATE_SIZE = 7
"""Numbers of a pedestrian's state: cx, cy, hx, hy, yaw, phase of the gait, length of a step."""
