"""Loss and held-out figures of the scan flow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from navrl.checks import check_positive
from navrl.networks import ScanFlow
from navrl.training.flow_data import FlowSamples

_SCORED_AT_ONCE = 500  # samples


@dataclass(frozen=True)
class FlowLoss:
    """Loss of a scan flow: binary cross-entropy of moving returns, and their velocity.

    Args:
        moving_speed: True speed above which a return is moving, m/s.
        positive_weight: Weight of moving returns in the cross-entropy, which are rare.
        velocity_weight: Weight of the velocity's smooth L1 loss, over returns of pedestrians.
        beta: Error above which that loss is linear, m/s.

    Raises:
        ValueError: If a value is not positive.
    """

    moving_speed: float = 0.2
    positive_weight: float = 2.0
    velocity_weight: float = 0.5
    beta: float = 0.1

    def __post_init__(self) -> None:
        """Check the values."""
        check_positive(**vars(self))

    def is_moving(self, samples: FlowSamples) -> Tensor:
        """Return the returns ``[S, N]`` of pedestrians that move."""
        return samples.shown & (samples.velocity.float().norm(dim=-1) > self.moving_speed)

    def __call__(self, moving: Tensor, velocity: Tensor, samples: FlowSamples) -> Tensor:
        """Return the loss, a scalar.

        Args:
            moving: ``[S, N]`` logits of the network.
            velocity: ``[S, N, 2]`` m/s of the network.
            samples: The S samples with the truth.
        """
        entropy = functional.binary_cross_entropy_with_logits(
            moving,
            self.is_moving(samples).to(moving.dtype),
            reduction="none",
            pos_weight=moving.new_tensor(self.positive_weight),
        )
        truth = samples.velocity.to(velocity.dtype)
        error = functional.smooth_l1_loss(velocity, truth, reduction="none", beta=self.beta)
        of_velocity = _mean(error.sum(dim=-1), samples.shown)
        return _mean(entropy, samples.returns) + self.velocity_weight * of_velocity


@torch.no_grad()
def flow_scores(net: ScanFlow, samples: FlowSamples, loss: FlowLoss) -> dict[str, float]:
    """Return the figures of a network on samples that it was not trained on.

    Args:
        net: Network.
        samples: Samples on the CPU.
        loss: Loss, whose threshold says which returns move.

    Returns:
        ``loss``; ``velocity_error_median`` and ``velocity_error_q90``, m/s, of moving returns;
        ``recall``, the share of moving returns that the network marks as moving; ``false_share``,
        the share of marked ones among the returns of anything but pedestrians. NaN without such.
    """
    device = next(net.parameters()).device
    losses, errors, marked, false = [], [], [], []
    for start in range(0, len(samples), _SCORED_AT_ONCE):
        part = samples[slice(start, start + _SCORED_AT_ONCE)].to(device)
        moving, velocity = net(part.ranges.float(), part.returns)
        losses.append(loss(moving, velocity, part) * len(part))
        is_moving, is_static = loss.is_moving(part), part.returns & ~part.shown
        errors.append((velocity - part.velocity.float()).norm(dim=-1)[is_moving])
        marked.append(moving[is_moving] > 0)
        false.append(moving[is_static] > 0)
    error = torch.cat(errors).double().cpu().numpy()
    middle, high = np.quantile(error, (0.5, 0.9)) if len(error) else (math.nan, math.nan)
    return {
        "loss": float(torch.stack(losses).sum() / len(samples)),
        "velocity_error_median": float(middle),
        "velocity_error_q90": float(high),
        "recall": float(torch.cat(marked).double().mean()),
        "false_share": float(torch.cat(false).double().mean()),
    }


def _mean(values: Tensor, weights: Tensor) -> Tensor:
    """Return the mean over the chosen entries; zero if there are none."""
    return (values * weights).sum() / weights.sum().clamp_min(1)
