"""Waypoints that lead back to a path that is out of sight."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from navrl import keys
from navrl.checks import check_counts, check_positive
from navrl.ops import se2
from navrl.ops.path import point_at
from navrl.ops.sight import is_hidden
from navrl.transforms.observation_map import (
    Keys,
    nested_keys,
    observed_specs,
    read,
    read_spec,
    real_spec,
)
from navrl.transforms.stall_timer import has_stalled
from navrl.transforms.waypoints import Waypoints

_IN_KEYS = (keys.POSE, keys.PATH, keys.POINTS, keys.RETURNS)
_OUT_KEYS = (keys.WAYPOINTS, keys.PATH_PROGRESS, keys.TRAIL, keys.TRAIL_STATE)


class ReturningWaypoints(Waypoints):
    """Compute the next points of the path, or those of the way back to where it was last seen.

    A robot that misses a door has a wall between itself and the path. This transform keeps the
    trail of the robot since the path was last in sight: a point where no trail point is within
    ``reach``; reaching an older point removes the newer ones. If all waypoints of the path have
    been hidden by returns of the scan for ``patience``, the waypoints follow the trail back and go
    on along the path. A robot within ``min_distance`` of the first one is at the path, also
    if something hides it: pedestrians on the path are no reason to turn back.

    Args:
        num_waypoints: See :class:`Waypoints`, as ``spacing``, ``include_closest``, ``ahead`` and
            ``behind``.
        spacing: Arc length between waypoints, m.
        include_closest: Whether the first point is the projection itself.
        ahead: Length of the search window after the last projection, m.
        behind: Length of the search window before the last projection, m.
        time_step: Time between two steps, s.
        patience: Time for which the path must be out of sight, s.
        min_distance: Distance to the first waypoint up to which the path is in sight, m.
        reach: Distance at which a trail point is reached, m; more than half of what the robot
            drives in a step, or the trail grows on the way back.
        num_trail_points: Largest number of trail points; a longer trail is not recorded.
        in_keys: Pose ``[*B, 3]``, path ``[*B, P, 2]``, and, ``points`` and ``returns`` if omitted,
            points ``[*B, N, 2]`` m in the robot frame and returns ``[*B, N]`` bool.
        out_keys: Waypoints ``[*B, N_f, 2]`` m in the robot frame, progress ``[*B, 1]`` m, and,
            ``trail`` and ``trail_state`` if omitted, the trail ``[*B, M, 2]`` m from the path's
            first point in world axes, and ``[*B, 2]`` the number of its points and the time for
            which the path has been out of sight, s.

    Raises:
        ValueError: If an argument is invalid, or later if the environment lacks a key.

    Example:
        >>> path = torch.tensor([[[0.0, 0.0], [4.0, 0.0]]])
        >>> points, returns = torch.tensor([[[0.5, 0.0]]]), torch.tensor([[True]])
        >>> waypoints, progress, trail, state = ReturningWaypoints()(
        ...     pose=torch.tensor([[1.0, -1.0, 1.57]]), path=path, points=points, returns=returns
        ... )
        >>> trail[0, 0].tolist(), state.tolist()
        ([1.0, -1.0], [[1.0, 0.0]])

    Reference:
        Not in the paper, whose robot has no way back.
    """

    INPUTS = (*Waypoints.INPUTS, "points", "returns")
    OUTPUTS = (*Waypoints.OUTPUTS, "trail", "state of the trail")

    def __init__(
        self,
        num_waypoints: int = 5,
        spacing: float = 0.3,
        include_closest: bool = False,
        ahead: float = 1.0,
        behind: float = 0.0,
        time_step: float = 0.2,
        patience: float = 0.6,
        min_distance: float = 0.7,
        reach: float = 0.4,
        num_trail_points: int = 32,
        in_keys: Keys = _IN_KEYS,
        out_keys: Keys = _OUT_KEYS,
    ) -> None:
        """Set values and keys."""
        given_in, given_out = nested_keys(in_keys), nested_keys(out_keys)
        if len(given_in) == 2:
            given_in = [*given_in, *_IN_KEYS[2:]]
        if len(given_out) == 2:
            given_out = [*given_out, *_OUT_KEYS[2:]]
        super().__init__(
            num_waypoints, spacing, include_closest, ahead, behind, given_in, given_out
        )
        check_positive(
            time_step=time_step, patience=patience, min_distance=min_distance, reach=reach
        )
        check_counts(num_trail_points=num_trail_points)
        self.time_step, self.patience = time_step, patience
        self.min_distance, self.reach = min_distance, reach
        self.num_trail_points = num_trail_points

    def restart(self, tensordict: TensorDictBase, progress: Tensor) -> None:
        """Overwrite the progress and clear the trail, see :meth:`Waypoints.restart`."""
        super().restart(tensordict, progress)
        state = read(self, tensordict, self.out_keys[3])
        tensordict.set(self.out_keys[3], torch.zeros_like(state))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        progress, trail, state = (read(self, tensordict, key) for key in self.out_keys[1:])
        return self._advance(next_tensordict, progress.squeeze(-1), trail, state)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Search the whole path and start a trail, as after a reset."""
        pose, _ = self._world(next_tensordict)
        empty = pose.new_zeros(*pose.shape[:-1], self.num_trail_points, 2, dtype=torch.float32)
        return self._advance(next_tensordict, None, empty, empty[..., 0, :])

    def _advance(
        self, tensordict: TensorDictBase, previous: Tensor | None, trail: Tensor, state: Tensor
    ) -> TensorDictBase:
        """Write the outputs of a step, given the progress, trail and state before it."""
        onward = self._ahead(tensordict, self._project(tensordict, previous))
        self._follow(tensordict, onward, trail, state)
        return self._choose(tensordict, onward)

    def _follow(
        self, tensordict: TensorDictBase, onward: Tensor, trail: Tensor, state: Tensor
    ) -> None:
        """Write the trail and its state after a step."""
        pose, path = self._world(tensordict)
        position = (pose[..., :2] - path[..., 0, :]).float()
        hidden = self._is_path_hidden(tensordict, onward)
        count = torch.where(hidden, state[..., 0], 0.0)
        time = torch.where(hidden, state[..., 1] + self.time_step, 0.0)
        slots = torch.arange(self.num_trail_points, device=trail.device)
        distance = torch.linalg.vector_norm(trail - position.unsqueeze(-2), dim=-1)
        reached = (distance < self.reach) & (slots < count.unsqueeze(-1))
        first = torch.where(reached, slots, self.num_trail_points).amin(-1)
        is_new = (first == self.num_trail_points) & (count < self.num_trail_points)
        added = is_new.unsqueeze(-1) & (slots == count.unsqueeze(-1))
        trail = torch.where(added.unsqueeze(-1), position.unsqueeze(-2), trail)
        count = torch.where(is_new, count + 1, torch.minimum(count, first + 1.0))
        tensordict.set(self.out_keys[2], trail)
        tensordict.set(self.out_keys[3], torch.stack([count, time], dim=-1))

    def _is_path_hidden(self, tensordict: TensorDictBase, onward: Tensor) -> Tensor:
        """Return whether all waypoints ``onward`` are out of sight, ``[*B]`` bool."""
        points, returns = (read(self, tensordict, key) for key in self.in_keys[2:])
        is_far = torch.linalg.vector_norm(onward[..., 0, :], dim=-1) > self.min_distance
        return is_far & is_hidden(onward, points.unsqueeze(-3), returns.unsqueeze(-2)).all(-1)

    def _write_points(self, tensordict: TensorDictBase, progress: Tensor) -> TensorDictBase:
        """Write the waypoints of stored progress and trail."""
        return self._choose(tensordict, self._ahead(tensordict, progress))

    def _choose(self, tensordict: TensorDictBase, onward: Tensor) -> TensorDictBase:
        """Write the waypoints, those of the trail where the path has been out of sight."""
        count, time = read(self, tensordict, self.out_keys[3]).unbind(-1)
        back = self._way_back(tensordict, onward, count)
        goes_back = has_stalled(time, self.patience, self.time_step) & (count > 1)
        waypoints = torch.where(goes_back[..., None, None], back, onward)
        return tensordict.set(self.out_keys[0], waypoints)

    def _way_back(self, tensordict: TensorDictBase, onward: Tensor, count: Tensor) -> Tensor:
        """Return waypoints along the trail and then along ``onward``, ``[*B, N_f, 2]``."""
        pose, path = self._world(tensordict)
        trail = read(self, tensordict, self.out_keys[2])
        slots = torch.arange(self.num_trail_points, device=trail.device)
        newest_first = (
            (count.unsqueeze(-1) - 2.0 - slots).clamp(min=0.0).long()
        )  # after the reached
        trail = trail.gather(-2, newest_first.unsqueeze(-1).expand_as(trail))
        trail = se2.transform_points(se2.inverse(pose), trail + path[..., :1, :]).float()
        way = torch.cat([torch.zeros_like(trail[..., :1, :]), trail, onward], dim=-2)
        offsets = self._offsets(count)
        return point_at(way, offsets.expand(*count.shape, *offsets.shape))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the specs of waypoints, progress and trail to those of the environment."""
        observation_spec = super().transform_observation_spec(observation_spec)
        points, returns = (read_spec(self, observation_spec, key) for key in self.in_keys[2:])
        if points.shape != (*returns.shape, 2):
            raise ValueError(
                f"{type(self).__name__} needs {self.in_keys[2]!r} [*B, N, 2] and "
                f"{self.in_keys[3]!r} [*B, N], got {tuple(points.shape)} and {tuple(returns.shape)}"
            )
        for key, spec in self._trail_specs(observation_spec):
            observation_spec[key] = spec
        return observation_spec

    def transform_input_spec(self, input_spec: TensorSpec) -> Composite:
        """Add progress and trail to the state spec, because a step reads them."""
        input_spec = super().transform_input_spec(input_spec)
        for key, spec in self._trail_specs(observed_specs(self)):
            input_spec["full_state_spec"][key] = spec
        return input_spec

    def _trail_specs(self, specs: Composite) -> list[tuple[object, TensorSpec]]:
        pose = read_spec(self, specs, self.in_keys[0])
        batch = pose.shape[:-1]
        trail = real_spec(pose, *batch, self.num_trail_points, 2)
        return list(zip(self.out_keys[2:], (trail, real_spec(pose, *batch, 2)), strict=True))
