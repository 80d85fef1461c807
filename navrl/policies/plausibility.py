"""Plausibility checks of a bundle's weights and of its robot's limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn
from torchrl.envs import Transform

from navrl.policies.nodes import BundleError
from navrl.sim import DifferentialDrive, Lidar, RobotModel

KINDS = {"transforms": Transform, "lidar": Lidar, "robot": RobotModel}
"""Type of each part of a bundle except the actor."""

MAX_SPEED = 10.0
"""Maximum speed of a bundle's robot, m/s; the fastest indoor bases reach 3."""
MAX_TURN_RATE = 8.0 * math.pi
"""Maximum turn rate of a bundle's robot, rad/s; a Kobuki reaches pi."""


def check_weights_kind(weights: Mapping[str, Tensor], actor: nn.Module, place: str) -> None:
    """Check that stored weights are floating point where the actor's are.

    Args:
        weights: Stored weights.
        actor: Actor that will load them.
        place: Name of the weights in messages.

    Raises:
        BundleError: If integers are stored for a floating-point weight, or vice versa; PyTorch
            would convert them without a warning.
    """
    own = actor.state_dict()
    for name, stored in weights.items():
        if name in own and stored.is_floating_point() != own[name].is_floating_point():
            raise BundleError(
                f"{place}: {name}: dtype={stored.dtype}: must be "
                f"{'floating point' if own[name].is_floating_point() else own[name].dtype}"
            )


def check_finite_weights(actor: nn.Module, place: str) -> None:
    """Check that the actor's weights are finite in the actor's own precision.

    Raises:
        BundleError: If a weight has a non-finite value.
    """
    for name, value in actor.state_dict().items():
        if not bool(value.isfinite().all()):
            bad = value[~value.isfinite()].flatten()[0].item()
            raise BundleError(f"{place}: {name}: value={bad}: must be finite")


def check_part(part: str, built: Any) -> None:
    """Check the type of a bundle's part, and that a robot's limits are plausible.

    Args:
        part: A name in :data:`KINDS`.
        built: Object that its node builds.

    Raises:
        BundleError: If it is of another type, if a speed exceeds :data:`MAX_SPEED`, or if the turn
            rate exceeds :data:`MAX_TURN_RATE`.
    """
    if not isinstance(built, KINDS[part]):
        raise BundleError(f"{part}: must be a {KINDS[part].__name__}, got {type(built).__name__}")
    if not isinstance(built, DifferentialDrive):
        return
    limits = {
        "min_speed": (MAX_SPEED, "m/s"),
        "max_speed": (MAX_SPEED, "m/s"),
        "max_turn_rate": (MAX_TURN_RATE, "rad/s"),
    }
    for name, (limit, unit) in limits.items():
        value = getattr(built, name)
        if not abs(value) <= limit:
            raise BundleError(f"robot.{name}={value:g}: must be at most {limit:.4g} {unit}")
