"""Torch functions that an exported graph lacks, or for which it must equal the kernels.

While :func:`torch.export.export` traces, the reference implementations compute in float64 as the
kernels do, and use loops and operators that ONNX has. Outside of an export they are unchanged.
"""

from __future__ import annotations

import torch
from torch import Tensor

_MAX_BLOCK = 16  # values


def is_exporting() -> bool:
    """Return whether the caller is being traced to an exported graph.

    Example:
        >>> is_exporting()
        False
    """
    return torch.compiler.is_exporting()


def kernel_precision(tensor: Tensor) -> Tensor:
    """Return float32 as float64 while exporting, because the kernels compute in float64.

    Example:
        >>> kernel_precision(torch.zeros(2)).dtype
        torch.float32
    """
    is_single = tensor.dtype == torch.float32
    return tensor.double() if is_single and is_exporting() else tensor


def cumulative_minimum(values: Tensor) -> Tensor:
    """Return the smallest value up to each position of the last dimension, any shape.

    Example:
        >>> cumulative_minimum(torch.tensor([3.0, 1.0, 2.0]))
        tensor([3., 1., 1.])
    """
    return doubled_minimum(values) if is_exporting() else values.cummin(dim=-1).values


def cumulative_maximum(values: Tensor) -> Tensor:
    """Return the largest value up to each position of the last dimension, any shape.

    Example:
        >>> cumulative_maximum(torch.tensor([1, 3, 2]))
        tensor([1, 3, 3])
    """
    return -doubled_minimum(-values) if is_exporting() else values.cummax(dim=-1).values


def doubled_minimum(values: Tensor) -> Tensor:
    """Return :func:`cumulative_minimum` by minima over windows of doubling length.

    Example:
        >>> doubled_minimum(torch.tensor([3.0, 1.0, 2.0]))
        tensor([3., 1., 1.])
    """
    length, shift = values.shape[-1], 1
    while shift < length:
        shifted = torch.minimum(values[..., shift:], values[..., :-shift])
        values = torch.cat([values[..., :shift], shifted], dim=-1)
        shift *= 2
    return values


def first_minimum(values: Tensor) -> Tensor:
    """Return the index of the first smallest value of the last dimension, int64.

    The minima of blocks come first, because an inference engine computes minima, but not their
    indices, on several values at once.

    Example:
        >>> first_minimum(torch.tensor([[3.0, 1.0, 2.0, 1.0]]))
        tensor([1])
    """
    count = values.shape[-1]
    size = max(size for size in range(1, _MAX_BLOCK + 1) if count % size == 0)
    blocks = values.reshape(-1, count // size, size)
    block = blocks.amin(-1).argmin(-1)
    start = torch.arange(blocks.shape[0], device=values.device) * (count // size)
    smallest = blocks.flatten(0, 1).index_select(0, start + block)
    return (block * size + smallest.argmin(-1)).reshape(values.shape[:-1])


def take_rows(values: Tensor, index: Tensor) -> Tensor:
    """Return the rows ``[S, N, K]`` of ``values [S, M, K]`` at ``index [S, N]``.

    Example:
        >>> take_rows(torch.tensor([[[5.0], [6.0], [7.0]]]), torch.tensor([[2, 0]]))
        tensor([[[7.],
                 [5.]]])
    """
    start = torch.arange(values.shape[0], device=index.device).unsqueeze(-1) * values.shape[1]
    rows = values.flatten(0, 1).index_select(0, (start + index).flatten())
    return rows.reshape(*index.shape, values.shape[-1])


def search_sorted(ascending: Tensor, values: Tensor) -> Tensor:
    """Return how many of the ascending ``[*B, N]`` are less than each value ``[*B, K]``, int64.

    Example:
        >>> search_sorted(torch.tensor([1.0, 2.0, 2.0]), torch.tensor([2.0, 3.0]))
        tensor([1, 3])
    """
    if is_exporting():
        return (ascending.unsqueeze(-2) < values.unsqueeze(-1)).sum(-1)
    return torch.searchsorted(ascending.contiguous(), values.contiguous())


def solve_motion(matrix: Tensor, vector: Tensor) -> Tensor:
    """Return the solution ``[S, 3]`` of symmetric, positive definite equations.

    Args:
        matrix: ``[S, 3, 3]``.
        vector: ``[S, 3]``.

    Example:
        >>> solve_motion(2.0 * torch.eye(3)[None], torch.tensor([[2.0, 4.0, 6.0]]))
        tensor([[1., 2., 3.]])
    """
    return eliminate(matrix, vector) if is_exporting() else torch.linalg.solve(matrix, vector)


def eliminate(matrix: Tensor, vector: Tensor) -> Tensor:
    """Return :func:`solve_motion` by elimination without pivots.

    Example:
        >>> eliminate(2.0 * torch.eye(3)[None], torch.tensor([[2.0, 4.0, 6.0]]))
        tensor([[1., 2., 3.]])
    """
    rows = list(torch.cat([matrix, vector.unsqueeze(-1)], dim=-1).unbind(-2))
    for index in range(3):
        pivot = rows[index] / rows[index][:, index, None]
        rows = [
            pivot if number == index else row - row[:, index, None] * pivot
            for number, row in enumerate(rows)
        ]
    return torch.stack([row[:, 3] for row in rows], dim=-1)


def symmetric_eigen(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Return eigenvalues ``[*B, 3]``, ascending, and eigenvectors ``[*B, 3, 3]`` as columns.

    Args:
        matrix: ``[*B, 3, 3]`` float64, symmetric.

    Example:
        >>> symmetric_eigen(torch.diag(torch.tensor([3.0, 1.0, 2.0]).double()))[0]
        tensor([1., 2., 3.], dtype=torch.float64)
    """
    return rotated_eigen(matrix) if is_exporting() else torch.linalg.eigh(matrix)


def rotated_eigen(matrix: Tensor, num_sweeps: int = 5) -> tuple[Tensor, Tensor]:
    """Return :func:`symmetric_eigen` by Jacobi's rotations, each of which clears one entry.

    Example:
        >>> matrix = torch.tensor([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 5.0]])
        >>> rotated_eigen(matrix)[0].round()
        tensor([1., 3., 5.])
    """
    vectors = torch.eye(3, dtype=matrix.dtype, device=matrix.device).expand_as(matrix)
    for row, column in ((0, 1), (0, 2), (1, 2)) * num_sweeps:
        off, spread = matrix[..., row, column], matrix[..., column, column] - matrix[..., row, row]
        angle = 0.5 * torch.atan2(2.0 * off, spread)
        turned = _rotation(angle, row, column)
        matrix, vectors = turned.mT @ matrix @ turned, vectors @ turned
    values = torch.stack([matrix[..., k, k] for k in range(3)], dim=-1)
    for left, right in ((0, 1), (1, 2), (0, 1)):  # ascending
        order = [0, 1, 2]
        order[left], order[right] = right, left
        swap = (values[..., left] > values[..., right]).unsqueeze(-1)
        values = torch.where(swap, values[..., order], values)
        vectors = torch.where(swap.unsqueeze(-1), vectors[..., order], vectors)
    return values, vectors


def _rotation(angle: Tensor, row: int, column: int) -> Tensor:
    """Return rotations ``[*B, 3, 3]`` in the plane of two axes."""
    cosine, sine = angle.cos(), angle.sin()
    one, zero = torch.ones_like(cosine), torch.zeros_like(cosine)
    entries = [[one if i == j else zero for j in range(3)] for i in range(3)]
    entries[row][row] = entries[column][column] = cosine
    entries[row][column], entries[column][row] = sine, -sine
    return torch.stack([torch.stack(line, dim=-1) for line in entries], dim=-2)
