"""Whether a disc-shaped robot touches an oriented box, and who is to blame.

Scalar functions in plain Python: the batched simulator's kernel is compiled from them, and a
simulator of one robot calls them as they are.
"""

NONE, STATIC, PEDESTRIAN, RUN_INTO = range(4)  # codes of navrl.sim.Contact

MOVING_SPEED = 0.05  # m/s; a robot driving slower than this hits nobody, others hit it


def nearest_point_on_box(
    x: float, y: float, cx: float, cy: float, hx: float, hy: float, cos: float, sin: float
) -> tuple[float, float]:
    """Return the point of the box nearest to (x, y), which is (x, y) itself inside.

    Args:
        x, y: the point, m.
        cx, cy, hx, hy: centre and half sizes of the box, m.
        cos, sin: of the box's yaw.
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


def blame(
    x: float, y: float, cos_yaw: float, sin_yaw: float, v: float, px: float, py: float
) -> int:
    """Return PEDESTRIAN if the robot moved into the pedestrian, RUN_INTO if it was hit.

    The robot is to blame if it drives faster than :data:`MOVING_SPEED` and the touched point lies
    in the half-plane that it drives towards.

    Args:
        x, y: the robot's centre, m.
        cos_yaw, sin_yaw: the direction the robot faces.
        v: its forward speed, m/s, negative when it backs up.
        px, py: the pedestrian's point nearest to the robot's centre, m.
    """
    ahead = (px - x) * cos_yaw + (py - y) * sin_yaw
    if (v > MOVING_SPEED and ahead > 0.0) or (v < -MOVING_SPEED and ahead < 0.0):
        return PEDESTRIAN
    return RUN_INTO
