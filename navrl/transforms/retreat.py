"""A way out for a robot whose path is blocked."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from navrl import keys
from navrl.checks import check_counts, check_positive, is_finite
from navrl.ops import se2
from navrl.ops.motion import FAR
from navrl.ops.path import point_at
from navrl.ops.returns import finite_returns
from navrl.ops.subgoal import free_distance
from navrl.transforms.observation_map import (
    Keys,
    cloned,
    nested_keys,
    observed_specs,
    read,
    read_spec,
    real_spec,
    world_values,
)
from navrl.transforms.stall_timer import has_stalled
from navrl.transforms.stateful import StatefulTransform

_STEP_M = 0.1  # m between the points of the path that are considered
_WINDOW_M = 4.0  # m of the path behind and ahead of the progress, from which a retreat keeps away
_HINT_M = 0.01  # m, length of a waypoint that only says where to turn
_RETREATS, _PAUSES = 1.0, 2.0  # of the third column of the state


class Retreat(StatefulTransform):
    """Lead a robot aside whose path is blocked, e.g. by a waiting pedestrian.

    A retreat begins if the robot has not made progress for ``patience``, and a return is in the
    way of a robot on the next ``look_ahead`` m of the path. Its target is the nearest place that
    the robot can reach on a straight line and that is ``aside`` of the path. Without one it is the
    place farthest from path and waypoints, where the robot chooses again. At the target the robot
    turns to the path and waits. The retreat ends when the path is free, or after ``duration``;
    another one may begin every ``duration + pause``. Otherwise the policy drives a robot without
    progress for ``patience``.

    A retreat is driven by :class:`Recovery`, which reads the out keys in place of waypoints and
    stall. Up to ``patience`` they equal those.

    Args:
        radius: Radius of the robot, m.
        time_step: Time between two steps, s.
        patience: Time without progress after which a retreat begins, s; longer than that of
            :class:`Recovery`, which drives before.
        duration: Longest duration of a retreat, s.
        pause: Time from the end of the longest retreat to the next one, s.
        aside: Distance from the path that lets pedestrians pass, m.
        max_distance: Largest distance of a target, m.
        look_ahead: Length of the part of the path that must be free, m; at most 4.
        reach: Distance at which a target is reached, m.
        margin: Required clearance between hull and points, m.
        num_bearings: Number of bearings of possible targets.
        num_distances: Number of their distances.
        in_keys: Waypoints ``[*B, F, 2]`` m in the robot frame, stall ``[*B, 2]`` of
            :class:`StallTimer`, points ``[*B, N, 2]`` m in the robot frame, returns ``[*B, N]``
            bool, pose ``[*B, 3]`` and path ``[*B, P, 2]`` in the same world frame, and progress
            ``[*B, 1]`` m.
        out_keys: For the recovery the waypoints ``[*B, F, 2]`` m, and the stall ``[*B, 2]``, zeros
            while the policy drives instead. For the next step ``[*B, 3]``:
            target (x, y) m in the robot frame, and 1 in a retreat, 2 while the
            policy drives instead, else 0.

    Raises:
        ValueError: If an argument is out of range, a number of keys is wrong, or later if the
            environment lacks a key.

    Example:
        >>> pose, path = torch.zeros(1, 3), torch.tensor([[[0.0, 0.0], [4.0, 0.0]]])
        >>> waypoints, progress = torch.tensor([[[0.3, 0.0], [0.6, 0.0]]]), torch.zeros(1, 1)
        >>> person, seen = torch.tensor([[[0.5, 0.0]]]), torch.tensor([[True]])
        >>> stall = torch.tensor([[0.0, 4.0]])
        >>> way, _, state = Retreat()(
        ...     waypoints=waypoints, stall=stall, points=person, returns=seen, pose=pose, path=path,
        ...     path_progress=progress,
        ... )
        >>> abs(way[0, 0, 1].item()) > 0.65, state[0, 2].item()
        (True, 1.0)

    Reference:
        Not in the paper.
    """

    def __init__(
        self,
        radius: float = 0.178,
        time_step: float = 0.2,
        patience: float = 4.0,
        duration: float = 4.0,
        pause: float = 3.0,
        aside: float = 0.65,
        max_distance: float = 1.5,
        look_ahead: float = 1.6,
        reach: float = 0.15,
        margin: float = 0.03,
        num_bearings: int = 36,
        num_distances: int = 5,
        in_keys: Keys = (
            *(keys.WAYPOINTS, keys.STALL, keys.POINTS, keys.RETURNS),
            *(keys.POSE, keys.PATH, keys.PATH_PROGRESS),
        ),
        out_keys: Keys = (keys.RECOVERY_WAYPOINTS, keys.RECOVERY_STALL, keys.RETREAT),
    ) -> None:
        """Check the values."""
        super().__init__(in_keys=nested_keys(in_keys), out_keys=nested_keys(out_keys))
        if len(self.in_keys) != 7 or len(self.out_keys) != 3:
            raise ValueError(
                f"Retreat: in_keys={self.in_keys}, out_keys={self.out_keys}: must be 7 keys "
                "(waypoints, stall, points, returns, pose, path, progress) and 3 (waypoints, "
                "stall, state)"
            )
        positive = {"radius": radius, "time_step": time_step, "patience": patience, "pause": pause}
        positive |= {"duration": duration, "aside": aside, "max_distance": max_distance}
        check_positive(**positive, reach=reach, look_ahead=look_ahead)
        check_counts(num_bearings=num_bearings, num_distances=num_distances)
        if not (is_finite(margin) and margin >= 0.0):
            raise ValueError(f"margin={margin!r}: must be >= 0 m and finite")
        if min(duration, pause) < time_step:
            raise ValueError(
                f"duration={duration}, pause={pause}: must be >= time_step={time_step} s"
            )
        if not reach < aside <= max_distance:
            raise ValueError(
                f"aside={aside}: must be > reach={reach} m and <= max_distance={max_distance} m"
            )
        if not _STEP_M <= look_ahead <= _WINDOW_M:
            raise ValueError(f"look_ahead={look_ahead}: must be in [{_STEP_M}, {_WINDOW_M}] m")
        self.time_step, self.patience, self.duration = time_step, patience, duration
        self.pause, self.aside, self.reach = pause, aside, reach
        self.room = radius + margin  # m, from the robot's center to points
        self._first = round(_WINDOW_M / _STEP_M)  # of the points of the path ahead
        self._last = self._first + round(look_ahead / _STEP_M)
        self.max_distance = max_distance
        self.num_bearings, self.num_distances = num_bearings, num_distances

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        state, last = (read(self, tensordict, key) for key in (self.out_keys[2], self.in_keys[4]))
        return self._advance(next_tensordict, state, last)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Start without a retreat, as after a reset."""
        waypoints = read(self, next_tensordict, self.in_keys[0])
        pose = read(self, next_tensordict, self.in_keys[4])
        return self._advance(next_tensordict, waypoints.new_zeros(*waypoints.shape[:-2], 3), pose)

    def _advance(self, tensordict: TensorDictBase, state: Tensor, last: Tensor) -> TensorDictBase:
        """Write the outputs of a step, given the state and the pose before it."""
        waypoints, stall, points, returns = (
            read(self, tensordict, key) for key in self.in_keys[:4]
        )
        returns = finite_returns(points, returns)
        points = torch.where(returns.unsqueeze(-1), points.float(), FAR)
        pose, path = (read(self, tensordict, key) for key in self.in_keys[4:6])
        pose, last, path = world_values(pose, last, path)
        window = self._path_nearby(tensordict, pose, path)
        before = state[..., 2]
        phase = self._phase(stall[..., 1], before, self._is_blocked(points, window))
        retreats = phase == _RETREATS
        moved = se2.relative(pose, last).float()
        target = se2.transform_points(moved, state[..., None, :2]).squeeze(-2)
        reached = (before == _RETREATS) & (torch.linalg.vector_norm(target, dim=-1) < self.reach)
        is_aside = _gap(target.unsqueeze(-2), window).squeeze(-1) >= self.aside - self.reach
        chooses = retreats & ((before != _RETREATS) | (reached & ~is_aside))
        target = self._chosen(chooses, target, points, returns, window, waypoints)
        way = self._way(target, reached & is_aside, waypoints)
        kept = torch.where(retreats.unsqueeze(-1), target, 0.0)
        waits = (phase == _PAUSES).unsqueeze(-1)
        values = (
            torch.where(retreats[..., None, None], way, waypoints),
            torch.where(waits, 0.0, stall),
            torch.cat([kept, phase.unsqueeze(-1)], dim=-1),
        )
        for key, value in zip(self.out_keys, values, strict=True):
            tensordict.set(key, value)
        return tensordict

    def _path_nearby(self, tensordict: TensorDictBase, pose: Tensor, path: Tensor) -> Tensor:
        """Return points of the path behind and ahead of the progress, ``[*B, W, 2]`` m."""
        progress = read(self, tensordict, self.in_keys[6])
        offset = torch.arange(-self._first, self._first + 1, device=progress.device) * _STEP_M
        points = point_at(path, progress + offset)
        return se2.transform_points(se2.inverse(pose), points).float()

    def _is_blocked(self, points: Tensor, window: Tensor) -> Tensor:
        """Return whether a robot on the path would touch a point, ``[*B]`` bool."""
        return (_gap(window[..., self._first : self._last, :], points) < self.room).any(-1)

    def _phase(self, since: Tensor, before: Tensor, blocked: Tensor) -> Tensor:
        """Return 1 in a retreat, 2 if the policy drives a stalled robot, else 0, ``[*B]``."""
        stalled = has_stalled(since, self.patience, self.time_step)
        passed = since - self.patience + 0.5 * self.time_step
        passed = torch.remainder(passed, self.duration + self.pause)
        may_begin = passed < self.time_step
        goes_on = (before == _RETREATS) & (passed < self.duration)
        retreats = stalled & blocked & (may_begin | goes_on)
        return torch.where(retreats, _RETREATS, torch.where(stalled, _PAUSES, 0.0))

    def _chosen(self, chooses: Tensor, target: Tensor, *seen: Tensor) -> Tensor:
        """Return the targets ``[*B, 2]``, new ones where a robot ``chooses``."""
        rows = chooses.reshape(-1).nonzero()[:, 0]
        if not len(rows):
            return target
        seen = tuple(value.reshape(-1, *value.shape[chooses.ndim :])[rows] for value in seen)
        return target.reshape(-1, 2).index_put((rows,), self._best(*seen)).reshape(target.shape)

    def _best(self, points: Tensor, returns: Tensor, window: Tensor, waypoints: Tensor) -> Tensor:
        """Return the best targets ``[R, 2]``, the present place where the robot cannot leave."""
        bearing, distance, grid = self._places(points.device)
        free = free_distance(
            points.unsqueeze(1), returns.unsqueeze(1), bearing.expand(len(points), -1), self.room
        )
        is_free = (free.unsqueeze(-1) >= distance).flatten(1)
        places = grid.expand(len(points), -1, -1)
        gap = _gap(places, window)
        from_path = torch.linalg.vector_norm(places - waypoints[:, :2].mean(1, True), dim=-1)
        nearest = 10.0 - torch.linalg.vector_norm(places, dim=-1)  # above all others
        score = torch.where(gap >= self.aside, nearest, gap + 0.5 * from_path)
        best = torch.where(is_free, score, -math.inf).argmax(-1)
        return torch.where(is_free.any(-1, keepdim=True), grid[best], 0.0)

    def _places(self, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
        """Return bearings ``[K]``, distances ``[D]``, and places there, ``[K * D, 2]`` m."""
        count, steps = self.num_bearings, self.num_distances
        bearing = torch.arange(count, device=device) * (2.0 * math.pi / count)
        distance = (torch.arange(steps, device=device) + 1.0) * (self.max_distance / steps)
        unit = torch.stack([bearing.cos(), bearing.sin()], dim=-1)
        return bearing, distance, (unit.unsqueeze(1) * distance.unsqueeze(-1)).reshape(-1, 2)

    @staticmethod
    def _way(target: Tensor, waits: Tensor, waypoints: Tensor) -> Tensor:
        """Return waypoints to the target, or for one that waits where it is and faces the path."""
        first = waypoints[..., :1, :]
        length = torch.linalg.vector_norm(first, dim=-1, keepdim=True)
        hint = first * (_HINT_M / length.clamp_min(_HINT_M))
        stay = torch.cat([hint, torch.zeros_like(waypoints[..., 1:, :])], dim=-2)
        return torch.where(waits[..., None, None], stay, target.unsqueeze(-2))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the specs of the outputs to those of the environment."""
        observation_spec = cloned(observation_spec)
        for key, spec in zip(self.out_keys, self._specs(observation_spec), strict=True):
            observation_spec[key] = spec
        return observation_spec

    def transform_input_spec(self, input_spec: TensorSpec) -> Composite:
        """Add the state of the retreat and the pose to the state spec: a step reads them."""
        input_spec = cloned(input_spec)
        input_spec["full_state_spec"][self.out_keys[2]] = self._specs(observed_specs(self))[2]
        pose = self.in_keys[4]
        input_spec["full_state_spec"][pose] = read_spec(self, observed_specs(self), pose).clone()
        return input_spec

    def _specs(self, specs: Composite) -> list[TensorSpec]:
        like = [read_spec(self, specs, self.in_keys[index]) for index in (0, 1, 4)]
        return [real_spec(spec, *spec.shape) for spec in like]


def _gap(places: Tensor, points: Tensor) -> Tensor:
    """Return the distance from each of ``[*B, K, 2]`` to the nearest point, ``[*B, K]``."""
    exact = "donot_use_mm_for_euclid_dist"  # a product of matrices is off by up to 2 mm
    return torch.cdist(places, points, compute_mode=exact).amin(-1)
