"""Search window of the projection on a path, shared by the kernel and the torch reference."""

# The search ends where the path is this many times as far from the position as its nearest point so
# far; the following segments belong to another branch, even if they are nearer. The ratio must be
# at least sqrt(2), which occurs for a robot that cuts a right-angled corner.
LEAVING_RATIO = 1.5


def check_window(ahead: float, behind: float) -> None:
    """Check the search lengths of :func:`navrl.ops.path.project_onto_path`, m.

    Raises:
        ValueError: If ``ahead`` is not positive or ``behind`` is negative.
    """
    if not ahead > 0.0:
        raise ValueError(f"ahead={ahead}: must be positive (m)")
    if not behind >= 0.0:
        raise ValueError(f"behind={behind}: must be at least 0 (m)")
