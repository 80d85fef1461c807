"""Location-based attention over the items of one stream."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from navrl.networks.mlp import mlp


class LocationAttention(nn.Module):
    """Weighted sum of item features with weights from a score per item.

    There is no pairwise attention: items are embedded, scored and mapped to features independently
    and only coupled by the softmax over the scores. A context (the waypoints) is concatenated with
    every item.

    Args:
        item_size: Number of features of an item, without the context.
        context_size: Number of features of the context.
        embedding: Layer sizes of the embedding network, ReLU after each.
        score: Layer sizes of the score network, linear last layer; must end in 1.
        feature: Layer sizes of the feature network, linear last layer.

    Raises:
        ValueError: If the last layer of the score network is not of size 1.

    Example:
        >>> attention = LocationAttention(item_size=4, context_size=2)
        >>> feature, weights = attention(torch.zeros(3, 30, 4), torch.zeros(3, 2))
        >>> feature.shape, weights.shape
        (torch.Size([3, 30]), torch.Size([3, 30]))

    Reference:
        Paper Sec. IV-E2 and its two equations; layer sizes from its footnote. The ReLU after the
        last layer of the embedding, but not of the other networks, follows the authors' public
        precursor.
    """

    def __init__(
        self,
        item_size: int,
        context_size: int,
        embedding: Sequence[int] = (256, 128, 64),
        score: Sequence[int] = (60, 50, 1),
        feature: Sequence[int] = (80, 50, 30),
    ) -> None:
        super().__init__()
        if score[-1] != 1:
            raise ValueError(f"score={list(score)}: the last layer must have size 1")
        self.item_size = item_size
        self.out_features = feature[-1]
        self.embedding = mlp(item_size + context_size, embedding, activate_last=True)
        self.score = mlp(embedding[-1], score)
        self.feature = mlp(embedding[-1], feature)

    def forward(self, items: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        """Return the weighted feature and the attention weights.

        Args:
            items: ``[*B, n, item_size]``.
            context: ``[*B, context_size]``, concatenated with each item.

        Returns:
            The weighted feature ``[*B, out_features]`` and the weights ``[*B, n]``, which sum to 1.
        """
        shared = context.unsqueeze(-2).expand(*items.shape[:-1], -1)
        embedded = self.embedding(torch.cat([items, shared], dim=-1))
        weights = torch.softmax(self.score(embedded).squeeze(-1), dim=-1)
        feature = self.feature(embedded)
        return (weights.unsqueeze(-2) @ feature).squeeze(-2), weights
