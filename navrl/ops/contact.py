"""Contact of a disc-shaped robot with boxes and discs, classified by the at-fault party.

Scalar functions in plain Python: the kernel of the batched simulator is compiled from them, and the
single-robot simulator calls them directly.
"""

import math

from navrl.deprecation import renamed_attributes

NONE, STATIC, PEDESTRIAN, HIT_BY_PEDESTRIAN = range(4)  # codes of navrl.sim.Contact

MOVING_SPEED = 0.05  # m/s; a slower robot counts as stationary and is never at fault


def nearest_point_on_box(
    x: float, y: float, cx: float, cy: float, hx: float, hy: float, cos: float, sin: float
) -> tuple[float, float]:
    """Return the point of a box that is nearest to (x, y); this point itself if inside the box.

    All lengths are in m: the box has its center at (cx, cy) and half sizes (hx, hy); ``cos`` and
    ``sin`` are those of its yaw.

    Example:
        >>> nearest_point_on_box(3.0, 0.5, cx=0.0, cy=0.0, hx=1.0, hy=1.0, cos=1.0, sin=0.0)
        (1.0, 0.5)
    """
    along = cos * (x - cx) + sin * (y - cy)
    across = cos * (y - cy) - sin * (x - cx)
    inner_along = min(max(along, -hx), hx)
    inner_across = min(max(across, -hy), hy)
    if inner_along == along and inner_across == across:
        return x, y
    return (
        cx + cos * inner_along - sin * inner_across,
        cy + sin * inner_along + cos * inner_across,
    )


def nearest_point_on_disc(
    x: float, y: float, cx: float, cy: float, radius: float
) -> tuple[float, float]:
    """Return the point of a disc that is nearest to (x, y); this point itself if inside.

    All lengths are in m.

    Example:
        >>> nearest_point_on_disc(3.0, 0.0, cx=0.0, cy=0.0, radius=1.0)
        (1.0, 0.0)
    """
    dx, dy = x - cx, y - cy
    distance = math.sqrt(dx * dx + dy * dy)
    if distance <= radius:
        return x, y
    share = radius / distance
    return cx + share * dx, cy + share * dy


def classify_contact(
    x: float, y: float, cos_yaw: float, sin_yaw: float, v: float, px: float, py: float
) -> int:
    """Return PEDESTRIAN if the robot is at fault for a contact, else HIT_BY_PEDESTRIAN.

    The robot is at fault if it drives faster than :data:`MOVING_SPEED` and the contact point lies
    in the half-plane of its direction of travel. Its center is at (x, y), m, and its heading is
    (cos_yaw, sin_yaw); (px, py), m, is the pedestrian's point nearest to that center.

    Args:
        v: Forward speed of the robot, m/s, negative in reverse.

    Example:
        >>> robot = {"x": 0.0, "y": 0.0, "cos_yaw": 1.0, "sin_yaw": 0.0, "v": 0.5}
        >>> classify_contact(**robot, px=0.2, py=0.0) == PEDESTRIAN
        True
        >>> classify_contact(**robot, px=-0.2, py=0.0) == HIT_BY_PEDESTRIAN
        True
    """
    ahead = (px - x) * cos_yaw + (py - y) * sin_yaw
    if (v > MOVING_SPEED and ahead > 0.0) or (v < -MOVING_SPEED and ahead < 0.0):
        return PEDESTRIAN
    return HIT_BY_PEDESTRIAN


__getattr__ = renamed_attributes(
    __name__, {"blame": "classify_contact", "RUN_INTO": "HIT_BY_PEDESTRIAN"}
)
