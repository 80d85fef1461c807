"""Commands that free a robot that makes no progress."""

from __future__ import annotations

import math

import torch
from tensordict import NestedKey
from torch import Tensor

from navrl import keys
from navrl.checks import check_positive, is_finite
from navrl.ops.dynamic_window import score_commands
from navrl.ops.motion import (
    check_commands,
    check_descriptor_speeds,
    moving_points,
    sample_commands,
)
from navrl.transforms.action_map import ActionMap
from navrl.transforms.observation_map import Keys
from navrl.transforms.stall_timer import has_stalled


class Recovery(ActionMap):
    """Replace the command of a robot that has stalled by one that frees it.

    The robot turns in place until the path is ahead. Then it drives the best command of a dynamic
    window, in which points keep the velocity of their descriptor, until it has made progress. The
    command is (v, w) on both sides; robots that make progress keep theirs.

    Args:
        radius: Radius of the robot, m.
        min_speed: Smallest speed, m/s; a negative one lets the robot drive back.
        max_speed: Largest speed of a recovery, m/s.
        max_turn_rate: Largest turn rate of the robot, rad/s.
        time_step: Time between two scans, s.
        patience: Time without progress after which the robot has stalled, s; that of the
            :class:`StallTimer`.
        facing: Largest angle between heading and path at which the robot drives, rad.
        horizon_steps: Number of steps for which a command is simulated.
        margin: Required clearance between hull and points, m.
        num_speeds: Number of sampled speeds.
        num_turn_rates: Number of sampled turn rates; odd, so that zero is one of them.
        min_descriptor_speed: Slower descriptors are treated as stationary, m/s.
        max_descriptor_speed: Faster descriptors are treated as mismatches, m/s.
        group_radius: Radius around a moving centroid within which points move with it, m.
        turn_weight: Penalty of the turn rate in the score of the window, m s/rad; among equal
            commands a small one selects the calmest, so that a robot that waits does not spin.
        scan_keys: Points ``[*B, N, 2]`` m in the robot frame, returns ``[*B, N]`` bool, descriptors
            ``[*B, G, 4]`` m, validity of their halves ``[*B, G, 2]`` bool, waypoints
            ``[*B, F, 2]`` m in the robot frame, and the stall ``[*B, 2]``.
        action_key: Key of the command ``[*B, 2]``, on both sides.

    Raises:
        ValueError: If a value is out of range, or later if a key is missing.

    Example:
        >>> recovery = Recovery(radius=0.178)
        >>> seen = torch.full((1, 1, 2), 3.5), torch.tensor([[False]])
        >>> no_motion = torch.zeros(1, 1, 4), torch.zeros(1, 1, 2, dtype=torch.bool)
        >>> behind, stalled = torch.tensor([[[-0.3, 0.0]]]), torch.tensor([[1.0, 2.0]])
        >>> still = torch.zeros(1, 2)
        >>> command = recovery.command(still, *seen, *no_motion, behind, stalled)
        >>> command[0, 0].item(), command[0, 1].item() > 1.0
        (0.0, True)

    Reference:
        Not in the paper. The window is that of
        :class:`navrl.policies.classical.DynamicWindow`.
    """

    _grid: Tensor

    def __init__(
        self,
        radius: float = 0.178,
        min_speed: float = 0.0,
        max_speed: float = 0.5,
        max_turn_rate: float = math.pi,
        time_step: float = 0.2,
        patience: float = 2.0,
        facing: float = 0.5,
        horizon_steps: int = 7,
        margin: float = 0.03,
        num_speeds: int = 6,
        num_turn_rates: int = 25,
        min_descriptor_speed: float = 0.3,
        max_descriptor_speed: float = 1.5,
        group_radius: float = 0.3,
        turn_weight: float = 0.01,
        scan_keys: Keys = (
            *(keys.POINTS, keys.RETURNS, keys.TAGD, keys.TAGD_VALID),
            *(keys.WAYPOINTS, keys.STALL),
        ),
        action_key: NestedKey | list[str] = keys.ACTION,
    ) -> None:
        names = ("points", "returns", "descriptors", "valid", "waypoints", "stall")
        super().__init__(names, scan_keys, action_key)
        check_positive(
            radius=radius,
            max_turn_rate=max_turn_rate,
            time_step=time_step,
            patience=patience,
            facing=facing,
            horizon_steps=horizon_steps,
            group_radius=group_radius,
        )
        check_commands(margin, min_speed, max_speed)
        self.radius, self.margin, self.facing = radius, margin, facing
        self.time_step, self.patience, self.horizon_steps = time_step, patience, horizon_steps
        self.max_turn_rate, self.group_radius = max_turn_rate, group_radius
        if not (is_finite(turn_weight) and turn_weight >= 0.0):
            raise ValueError(f"turn_weight={turn_weight!r}: must be >= 0 and finite")
        self.turn_weight = turn_weight
        self.speed_range = check_descriptor_speeds(min_descriptor_speed, max_descriptor_speed)
        grid = sample_commands(min_speed, max_speed, max_turn_rate, num_speeds, num_turn_rates)
        self.register_buffer("_grid", grid, persistent=False)

    def command(self, action: Tensor, *seen: Tensor) -> Tensor:
        """Return the commands ``[*B, 2]``, m/s and rad/s.

        Args:
            action: ``[*B, 2]``, requested (v, w).
            seen: Entries of ``scan_keys``, see the class.
        """
        batch = action.shape[:-1]
        flat = [value.reshape(-1, *value.shape[len(batch) :]) for value in (action, *seen)]
        stalled = has_stalled(flat[-1][:, 1], self.patience, self.time_step)
        rows = stalled.nonzero()[:, 0]
        if not len(rows):
            return action
        freed = self._freed(*(value[rows] for value in flat[1:-1]))
        return flat[0].index_put((rows,), freed.to(action.dtype)).reshape(*batch, 2)

    def _freed(
        self, points: Tensor, returns: Tensor, tagd: Tensor, valid: Tensor, waypoints: Tensor
    ) -> Tensor:
        """Return the commands of robots that have stalled, ``[R, 2]``."""
        ahead = waypoints[:, 0]
        bearing = torch.atan2(ahead[:, 1], ahead[:, 0])
        turn_rate = (bearing / self.time_step).clamp(-self.max_turn_rate, self.max_turn_rate)
        turn = torch.stack([torch.zeros_like(turn_rate), turn_rate], dim=-1)
        drive = self._best(points, returns, tagd, valid, waypoints)
        return torch.where((bearing.abs() > self.facing).unsqueeze(-1), turn, drive)

    def _best(
        self, points: Tensor, returns: Tensor, tagd: Tensor, valid: Tensor, waypoints: Tensor
    ) -> Tensor:
        """Return the best commands of the window, ``[R, 2]``."""
        points, motion = moving_points(
            points,
            returns,
            tagd,
            valid,
            speed_range=self.speed_range,
            time_step=self.time_step,
            group_radius=self.group_radius,
        )
        score = score_commands(
            self._grid.expand(len(points), -1, -1),
            points,
            motion,
            waypoints.float(),
            radius=self.radius,
            time_step=self.time_step,
            horizon_steps=self.horizon_steps,
            margin=self.margin,
        )
        score = score - self.turn_weight * self._grid[:, 1].abs()
        return self._grid[score.argmax(-1)]
