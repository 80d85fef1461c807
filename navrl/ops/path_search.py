"""Bounds of the search for a projection on a path, shared by kernel and reference."""

# The search for a projection ends where the path has led this many times as far from the position
# as its nearest point so far: what comes after is another branch, even if it is nearer. Not
# less than sqrt(2), which is what a robot sees that cuts a right angle.
LEAVING_RATIO = 1.5


def check_window(ahead: float, behind: float) -> None:
    """Check the search lengths of :func:`navrl.ops.path.project_onto_path`, m.

    Raises:
        ValueError: If ``ahead`` is not positive or ``behind`` is negative.
    """
    if not ahead > 0.0:
        raise ValueError(f"ahead must be positive (m), got {ahead}")
    if not behind >= 0.0:
        raise ValueError(f"behind must be at least 0 (m), got {behind}")
