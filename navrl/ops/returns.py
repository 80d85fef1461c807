"""Which points of a scan are to be believed."""

from torch import Tensor


def finite_returns(points: Tensor, returns: Tensor) -> Tensor:
    """Take points with a coordinate that is NaN or infinite out of the returns.

    One broken point must neither spoil a whole scan nor pass as a point at the origin.

    Args:
        points: ``[*B, N, 2]`` m.
        returns: ``[*B, N]`` bool, which points are real.

    Returns:
        ``[*B, N]`` bool.
    """
    return returns & points.isfinite().all(-1)
