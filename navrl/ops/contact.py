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

    All lengths are in m: the box has its centre at (cx, cy) and half sizes (hx, hy), and ``cos``
    and ``sin`` are those of its yaw.
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
    in the half-plane that it drives towards. Its centre is at (x, y), m, and it faces
    (cos_yaw, sin_yaw); (px, py), m, is the pedestrian's point nearest to that centre.

    Args:
        v: the robot's forward speed, m/s, negative when it backs up.
    """
    ahead = (px - x) * cos_yaw + (py - y) * sin_yaw
    if (v > MOVING_SPEED and ahead > 0.0) or (v < -MOVING_SPEED and ahead < 0.0):
        return PEDESTRIAN
    return RUN_INTO
