"""Gait of a walking pedestrian, whose two legs are discs in the plane of a lidar.

Scalar functions in plain Python: the kernels of the batched simulator are compiled from them, and
the reference simulator calls them directly.

The phase counts steps. A foot with phase p in [-0.6, 0.6] is planted, and the body passes over it
at p = 0; from 0.6 to 1.4 it swings to the next position, two steps ahead. The phase of the right
foot is one step ahead of that of the left one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

Speed = TypeVar("Speed", float, "Tensor")

STANCE = 0.6  # share of a stride in which a foot is planted, walking; Winter 2009
STEP_LENGTH_M = 0.4625  # m at speed 0, Seitz and Koester 2012, Fig. 2
STEP_LENGTH_PER_SPEED = 0.2345  # m per m/s, the same regression
HALF_STEP_WIDTH_M = 0.09  # m from the center line to the axis of a leg at the height of a shin
MAX_STRIDE = 0.63  # step lengths from the body's center to that of a foot, at the end of its swing
MAX_FOOT_REACH_M = 1.0  # m from the body's center to the far side of a leg, up to 3 m/s


def step_length(speed: Speed) -> Speed:
    """Return the length of a step in m at a walking speed in m/s, a number or a tensor.

    Example:
        >>> round(step_length(1.0), 3)
        0.697

    Reference:
        Seitz and Koester, "Natural discretization of pedestrian movement in continuous space",
        2012: a linear regression of measured steps.
    """
    return STEP_LENGTH_M + STEP_LENGTH_PER_SPEED * speed


def foot_offset(phase: float, length: float) -> float:
    """Return how far a foot is ahead of the body's center, m.

    Args:
        phase: Phase of the foot, in steps.
        length: Length of a step, m.

    Example:
        >>> foot_offset(0.25, length=0.8)  # planted: the body has walked a quarter of a step past
        -0.2
        >>> foot_offset(1.0, length=0.8)  # in the middle of its swing
        0.0
    """
    part = (phase + STANCE) % 2.0 - STANCE  # in [-STANCE, 2 - STANCE)
    if part <= STANCE:
        return -part * length
    share = (part - STANCE) / (2.0 - 2.0 * STANCE)
    return (2.0 * share * share * (3.0 - 2.0 * share) - part) * length


def foot_center(
    x: float, y: float, cos: float, sin: float, phase: float, length: float, side: int
) -> tuple[float, float]:
    """Return the center (x, y) of a leg, m.

    Args:
        x: Center of the body, m.
        y: The same.
        cos: Cosine of the direction of walking.
        sin: Sine of it.
        phase: Phase of the left foot, in steps.
        length: Length of a step, m; 0 for a stationary pedestrian, whose feet are side by side.
        side: 0 for the left leg, 1 for the right one.

    Example:
        >>> foot_center(0.0, 0.0, 1.0, 0.0, phase=0.25, length=0.8, side=0)
        (-0.2, 0.09)
    """
    ahead = foot_offset(phase + side, length)
    left = HALF_STEP_WIDTH_M * (1.0 - 2.0 * side)
    return x + cos * ahead - sin * left, y + sin * ahead + cos * left
