"""Reward terms, weights included; the reward is their sum and each is logged by name."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from navrl.ops.path import point_at


@dataclass(frozen=True)
class Transition:
    """Inputs of the reward terms for one step of N worlds.

    Args:
        position: ``[N, 2]`` m, robot center after the step, world.
        path: ``[N, P, 2]`` m, global path, world.
        path_length: ``[N]`` m.
        progress_before: ``[N]`` m, arc length of the robot's projection on the path at s_t.
        progress: ``[N]`` m, the same at s_{t+1}.
        nearest: ``[N]`` m, from the robot's center to the nearest return, noise-free, at s_{t+1}.
        collided: ``[N]`` bool.
        reached: ``[N]`` bool, the goal was reached.
        robot_radius: Radius of the robot, m.
        velocity: ``[N, C]``, velocity of the robot after the step, e.g. (v, w), m/s and rad/s.
        command_before: ``[N, C]``, command of the previous step; zero in the first step.
        command: ``[N, C]``, command of this step.
    """

    position: Tensor
    path: Tensor
    path_length: Tensor
    progress_before: Tensor
    progress: Tensor
    nearest: Tensor
    collided: Tensor
    reached: Tensor
    robot_radius: float
    velocity: Tensor
    command_before: Tensor
    command: Tensor


def _one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise ValueError(f"{name}={value!r}: must be one of {list(allowed)}")


@dataclass(frozen=True)
class Collision:
    """Reward of -weight for a step with a contact, which ends the episode.

    Reference:
        Paper Sec. IV-D, r_collision with alpha_1 = 10.
    """

    weight: float = 10.0

    def __call__(self, step: Transition) -> Tensor:
        return -self.weight * step.collided.float()


@dataclass(frozen=True)
class Guidance:
    """Reward of -weight times the distance to a point ahead on the path.

    Args:
        weight: Weight of the term, per m.
        lookahead: Arc length from the robot's projection to the guidance point, m.
        point: ``"before_move"`` uses the point at s_t, so driving towards it increases the reward;
            ``"after_move"`` uses the point at s_{t+1}, whose reward is the same whether the robot
            drives or stands.

    Reference:
        Paper Sec. IV-D, r_guide with alpha_2 = 0.2 and 0.6 m. The paper does not specify the state
        at which the point is taken.
    """

    weight: float = 0.2
    lookahead: float = 0.6
    point: str = "before_move"

    def __post_init__(self) -> None:
        _one_of("point", self.point, ("before_move", "after_move"))

    def __call__(self, step: Transition) -> Tensor:
        progress = step.progress_before if self.point == "before_move" else step.progress
        target = point_at(step.path, progress + self.lookahead)
        return -self.weight * (target - step.position).norm(dim=-1)


@dataclass(frozen=True)
class Proximity:
    """Reward of -weight times the depth of the nearest obstacle inside ``distance``.

    Args:
        weight: Weight of the term, per m.
        distance: Distance d_prox below which the term is negative, m.
        measured_from: ``"lidar"`` (the robot's center, above which the paper's lidar is) or
            ``"hull"`` (minus the robot's radius).

    Reference:
        Paper Sec. IV-D, r_prox with alpha_3 = 3 and d_prox = 0.5 m. "Between robot and obstacle"
        is interpreted as from the lidar's center, after the authors' precursor.
    """

    weight: float = 3.0
    distance: float = 0.5
    measured_from: str = "lidar"

    def __post_init__(self) -> None:
        _one_of("measured_from", self.measured_from, ("lidar", "hull"))

    def __call__(self, step: Transition) -> Tensor:
        hull = step.robot_radius if self.measured_from == "hull" else 0.0
        return -self.weight * (self.distance - (step.nearest - hull)).clamp_min(0.0)


@dataclass(frozen=True)
class Goal:
    """Reward of +weight at the goal, which ends the episode. Not in the paper."""

    weight: float = 10.0

    def __call__(self, step: Transition) -> Tensor:
        return self.weight * step.reached.float()


@dataclass(frozen=True)
class Progress:
    """Reward for progress along the path, weight per meter. Not in the paper.

    With the potential Phi = -(remaining path length), the two forms are

    - ``"difference"``: Phi(s') - Phi(s);
    - ``"potential"``: gamma Phi(s') - Phi(s) with Phi = 0 at terminal states, which leaves the
      optimal policy of the other terms unchanged but adds the remaining length at an early
      collision.

    Args:
        weight: Weight of the term, per m.
        form: One of the two forms above.
        gamma: Discount factor of the learner, only for ``"potential"``.

    Reference:
        Ng, Harada and Russell, "Policy invariance under reward transformations", ICML 1999.
    """

    weight: float = 2.0
    form: str = "difference"
    gamma: float = 0.98

    def __post_init__(self) -> None:
        _one_of("form", self.form, ("difference", "potential"))

    def __call__(self, step: Transition) -> Tensor:
        gained = step.progress - step.progress_before
        if self.form == "difference":
            return self.weight * gained
        before = step.progress_before - step.path_length
        after = torch.where(step.collided | step.reached, 0.0, step.progress - step.path_length)
        return self.weight * (self.gamma * after - before)


@dataclass(frozen=True)
class Smoothness:
    """Negative reward for the squared change of the command (v, w). Not in the paper.

    Squares cost reversals much and exploration noise little. With absolute values, commands at
    their limits, where half of the noise is clipped, are rewarded: a trained policy stood still.

    Args:
        turn_rate_change: Weight of the squared change of w since the previous step, per (rad/s)^2.
        speed_change: Weight of the squared change of v since the previous step, per (m/s)^2.
    """

    turn_rate_change: float = 0.015
    speed_change: float = 0.0

    def __call__(self, step: Transition) -> Tensor:
        """Return the reward ``[N]`` of a step."""
        change = (step.command - step.command_before).square()
        return -(self.speed_change * change[:, 0] + self.turn_rate_change * change[:, 1])
