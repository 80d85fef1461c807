"""Pedestrians that react by social forces."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from navrl.checks import check_positive
from navrl.sim.draws import exp
from navrl.sim.walkers import RouteWalkers

if TYPE_CHECKING:
    from navrl.sim.state import SimState

_STEP_S = 0.02  # s, longest step of the integration
_MAX_SPEED_SHARE = 1.3  # of the preferred speed, Helbing and Molnar 1995
_AWAY_M = 1e4  # m, position of absent pedestrians, and of a robot that is not seen
_FAR = 10.0  # ranges of a force beyond which it is 5e-5 of its strength, and computed as such


class SocialForcePedestrians(RouteWalkers):
    """Reactive pedestrians on their routes that are pushed away by others, the robot and walls.

    The acceleration of a pedestrian is ``(preferred - velocity) / relaxation_s`` plus, from each
    other pedestrian and the nearest obstacle, ``strength * exp(-gap / reach)`` along the line
    between them. The gap to the robot is less by the swing of the feet of those with legs. What is
    behind the pedestrian pushes less.

    Args:
        sees_robot: Whether pedestrians are pushed away by the robot.
        robot_radius: Of the hull, m.
        relaxation_s: Time in which a pedestrian attains its preferred velocity, s.
        strength: Acceleration at contact, m/s^2.
        reach: Gap at which it is 37 % of that, m.
        rear: Weight of what is right behind a pedestrian, in [0, 1]; 1 for what is ahead.
        sidestep: Angle to the right of the preferred velocity, see :class:`RouteWalkers`, rad.
        share: Share of the episodes in which pedestrians react, see :class:`RouteWalkers`.

    Raises:
        ValueError: If a value is out of range.

    Reference:
        Helbing, Farkas and Vicsek, "Simulating dynamical features of escape panic", Nature 2000:
        0.5 s, 2000 N for 80 kg, 0.08 m; without their forces of contact.
    """

    def __init__(
        self,
        sees_robot: bool = True,
        robot_radius: float = 0.178,
        relaxation_s: float = 0.5,
        strength: float = 25.0,
        reach: float = 0.08,
        rear: float = 0.5,
        sidestep: float = 0.15,
        share: float = 1.0,
    ) -> None:
        """Check the values."""
        super().__init__(sidestep, share)
        check_positive(robot_radius=robot_radius, relaxation_s=relaxation_s)
        check_positive(strength=strength, reach=reach)
        if not 0 <= rear <= 1:
            raise ValueError(f"rear={rear}: must be in [0, 1]")
        self.sees_robot, self.robot_radius = sees_robot, robot_radius
        self.relaxation_s, self.strength, self.reach = relaxation_s, strength, reach
        self.rear = rear

    def velocities(
        self,
        state: SimState,
        place: Tensor,
        preferred: Tensor,
        rows: dict[str, Tensor],
        duration_s: float,
    ) -> Tensor:
        """Return the mean velocities in the next step, [N, K, 2] m/s."""
        preferred = preferred.nan_to_num(0.0)
        start = place.nan_to_num(_AWAY_M)
        walks = rows["walks"][..., None]
        velocity = rows["velocity"].masked_fill(~walks, 0.0)
        limit = _MAX_SPEED_SHARE * rows["speed"][..., None]
        robot = state.pose[:, None, :2].double().cpu()
        robot = robot if self.sees_robot else torch.full_like(robot, -_AWAY_M)
        steps = math.ceil(duration_s / _STEP_S - 1e-9)
        at, step_s = start, duration_s / steps
        walls = _Walls.of(rows)
        for _ in range(steps):
            force = (preferred - velocity) / self.relaxation_s
            force = force + self._from_others(at, velocity, robot, rows)
            force = force + self._push(at, velocity, walls.nearest(at), rows["radius"])
            velocity = velocity + step_s * force
            speed = _length(velocity).clamp_min(1e-9)
            velocity = velocity * (limit / speed).clamp(max=1.0) * walks
            at = at + step_s * velocity
        return (at - start) / duration_s

    def _from_others(
        self, at: Tensor, velocity: Tensor, robot: Tensor, rows: dict[str, Tensor]
    ) -> Tensor:
        """Return the accelerations by the robot and other pedestrians, [N, K, 2] m/s^2."""
        radius = rows["radius"]
        force = self._push(at, velocity, robot, radius + rows["feet"] + self.robot_radius)
        for other in range(at.shape[1]):  # in order: a sum's rounding depends on the batch
            gap = radius + radius[:, other : other + 1]
            push = self._push(at, velocity, at[:, other : other + 1], gap)
            push[:, other] = 0.0
            force = force + push
        return force

    def _push(self, at: Tensor, velocity: Tensor, point: Tensor, radius: Tensor) -> Tensor:
        """Return the accelerations away from points [N, K or 1, 2], [N, K, 2] m/s^2.

        ``radius`` [N, K] m is the distance at contact.
        """
        offset = at - point
        distance = _length(offset).clamp_min(1e-6)
        away = offset / distance
        gap = ((distance - radius[..., None]) / self.reach).clamp(0.0, _FAR)
        speed = _length(velocity).clamp_min(1e-6)
        ahead = -(away * velocity / speed)
        cosine = ahead[..., :1] + ahead[..., 1:]
        weight = self.rear + (1.0 - self.rear) * 0.5 * (1.0 + cosine)
        return self.strength * weight / exp(gap) * away


class _Walls(NamedTuple):
    """Boxes of N worlds.

    Args:
        center: [N, 1, W, 2] m.
        half: [N, 1, W, 2] m.
        cos: [N, 1, W] of their yaw.
        sin: [N, 1, W].
        exists: [N, 1, W] bool.
    """

    center: Tensor
    half: Tensor
    cos: Tensor
    sin: Tensor
    exists: Tensor

    @classmethod
    def of(cls, rows: dict[str, Tensor]) -> _Walls:
        """Return the boxes of the rows of :class:`RouteWalkers`."""
        boxes = rows["walls"][:, None]
        exists = torch.arange(boxes.shape[2]) < rows["num_walls"][:, None, None]
        # Elementwise: the rounding of torch.cos depends on the position in the batch.
        cos, sin = (boxes[..., 4].clone().apply_(function) for function in (math.cos, math.sin))
        return cls(boxes[..., :2], boxes[..., 2:4], cos, sin, exists)

    def nearest(self, at: Tensor) -> Tensor:
        """Return the nearest point of the boxes to points [N, K, 2] m, far away without boxes."""
        if not self.exists.shape[-1]:
            return torch.full_like(at, -_AWAY_M)
        local = _turned(at[:, :, None] - self.center, self.cos, -self.sin)
        inside = torch.maximum(torch.minimum(local, self.half), -self.half)
        distance = _length(local - inside)[..., 0].masked_fill(~self.exists, torch.inf)
        index = distance.argmin(-1)[..., None, None].expand(-1, -1, 1, 2)
        points = self.center + _turned(inside, self.cos, self.sin)
        return points.gather(2, index).squeeze(2).where(self.exists.any(-1)[..., None], -_AWAY_M)


def _length(vector: Tensor) -> Tensor:
    """Return the lengths [*B, 1] of vectors [*B, 2], equal in any batch."""
    x, y = vector[..., :1], vector[..., 1:]
    return torch.sqrt(x * x + y * y)


def _turned(vector: Tensor, cos: Tensor | float, sin: Tensor | float) -> Tensor:
    """Return vectors [*B, 2] turned counterclockwise."""
    x, y = vector.unbind(-1)
    return torch.stack((cos * x - sin * y, sin * x + cos * y), dim=-1)
