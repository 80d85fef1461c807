"""Filter for non-finite scan returns."""

from torch import Tensor


def finite_returns(points: Tensor, returns: Tensor) -> Tensor:
    """Exclude points with NaN or infinite coordinates from the returns.

    An invalid point would otherwise propagate NaN to the whole scan or appear at the origin.

    Args:
        points: ``[*B, N, 2]`` m.
        returns: ``[*B, N]`` bool, which points are real returns.

    Returns:
        ``[*B, N]`` bool.

    Example:
        >>> import torch
        >>> points = torch.tensor([[1.0, 0.0], [torch.nan, 0.0]])
        >>> finite_returns(points, torch.tensor([True, True]))
        tensor([ True, False])
    """
    return returns & points.isfinite().all(-1)
