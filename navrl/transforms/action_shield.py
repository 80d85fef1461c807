"""Replace commands that lead to a collision, as the last step before they are driven."""

from __future__ import annotations

import math

import torch
from tensordict import NestedKey
from torch import Tensor

from navrl import keys
from navrl.ops.motion import FAR, point_motion, room_along, sample_commands
from navrl.ops.unicycle import advance_poses
from navrl.transforms.action_map import ActionMap, check_positive
from navrl.transforms.observation_map import Keys

_MAX_COMMANDS = 10_000  # of the grid, and times at which each is checked: both are in memory
_MAX_TIMES = 100
_SAME_ROOM = 1e-3
"""m, clearances that differ by less are equal: far below the noise of a range."""


class ActionShield(ActionMap):
    """Replace a command that leads to a collision by the most similar one that does not.

    A command is held for ``horizon``; points of the scan stay in place, or move on at the velocity
    of the descriptor that they belong to. The clearance of a command is the least distance between
    the hull and a point, now and at later checked times. A command with more clearance than
    ``margin`` passes unchanged. Otherwise the most similar command of a grid with more clearance
    than ``margin`` is driven, by the difference in units of the limits' ranges; if there is none,
    the command with the most clearance, and of those that tie the most similar to the one asked
    for, which is itself a candidate. No command has more clearance than the present one, so beside
    a wall that is already within ``margin`` a stop stays a stop, unless a point is predicted to
    move in.

    The action is (v, w) on both sides. Nothing privileged is read, and there is no guarantee: the
    robot can still hit an obstacle out of sight, or a pedestrian who turns.

    Args:
        radius: Of the robot, m.
        min_speed: Of the robot, m/s.
        max_speed: Of the robot, m/s.
        max_turn_rate: Of the robot, rad/s.
        time_step: Between two scans, s.
        horizon: Time for which a command is held, s.
        checks_per_step: Times that are checked in each time step; the present is checked too.
        margin: Kept between hull and points, m.
        num_speeds: Speeds of the grid.
        num_turn_rates: Turn rates of the grid; odd, so that straight on is one of them.
        least_speed: A descriptor that moves slower is stationary, m/s: noise of scan and alignment.
        most_speed: A faster one is a mismatch, m/s.
        group_radius: Around a moved centroid within which points move with it, m.
        scan_keys: Points ``[*B, N, 2]`` m in the robot frame, returns ``[*B, N]`` bool, descriptors
            ``[*B, G, 4]`` m and which halves are real ``[*B, G, 2]`` bool, at the time of the
            action.
        action_key: The command ``[*B, 2]``, for both sides.

    Raises:
        ValueError: If a value is out of range, or later if a key is missing.

    Reference:
        Not in the paper. Shielding of learned policies: Alshiekh et al., "Safe Reinforcement
        Learning via Shielding", 2018. Ours: the arcs of a dynamic window (Fox et al. 1997) among
        points that walk on with their TAGDs.
    """

    def __init__(
        self,
        radius: float = 0.178,
        min_speed: float = 0.0,
        max_speed: float = 1.0,
        max_turn_rate: float = math.pi,
        time_step: float = 0.2,
        horizon: float = 0.4,
        checks_per_step: int = 2,
        margin: float = 0.03,
        num_speeds: int = 11,
        num_turn_rates: int = 25,
        least_speed: float = 0.3,
        most_speed: float = 1.5,
        group_radius: float = 0.3,
        scan_keys: Keys = (keys.POINTS, keys.RETURNS, keys.TAGD, keys.TAGD_VALID),
        action_key: NestedKey | list[str] = keys.ACTION,
    ) -> None:
        super().__init__(("points", "returns", "descriptors", "valid"), scan_keys, action_key)
        check_positive(
            radius=radius,
            max_turn_rate=max_turn_rate,
            time_step=time_step,
            horizon=horizon,
            group_radius=group_radius,
            checks_per_step=checks_per_step,
        )
        if not (0.0 <= margin < math.inf and -math.inf < min_speed < max_speed < math.inf):
            raise ValueError(
                f"margin={margin}: must be >= 0; min_speed={min_speed}, max_speed={max_speed}: "
                "need min_speed < max_speed"
            )
        if not 0.0 < least_speed < most_speed:
            raise ValueError(
                f"least_speed={least_speed}, most_speed={most_speed}: "
                "need 0 < least_speed < most_speed"
            )
        count = _check_sizes(horizon, time_step, checks_per_step, num_speeds, num_turn_rates)
        self.radius, self.margin, self.time_step = radius, margin, time_step
        self.speed_range = (least_speed, most_speed)
        self.group_radius = group_radius
        self.times = [horizon * k / count for k in range(count + 1)]
        grid = sample_commands(min_speed, max_speed, max_turn_rate, num_speeds, num_turn_rates)
        self.register_buffer("_grid", grid, persistent=False)
        self._range = (max_speed - min_speed, 2.0 * max_turn_rate)

    def command(self, action: Tensor, *seen: Tensor) -> Tensor:
        """Return the commands ``[*B, 2]`` m/s and rad/s to drive.

        Args:
            action: ``[*B, 2]`` (v, w) asked for.
            seen: Points ``[*B, P, 2]`` m, returns ``[*B, P]`` bool, descriptors ``[*B, G, 4]`` m
                and which halves are real ``[*B, G, 2]`` bool.
        """
        batch = action.shape[:-1]
        flat = (value.reshape(-1, *value.shape[len(batch) :]) for value in (action, *seen))
        return self._shielded(*flat).reshape(*batch, 2)

    def _shielded(
        self, command: Tensor, points: Tensor, returns: Tensor, tagd: Tensor, valid: Tensor
    ) -> Tensor:
        points = torch.where(returns.unsqueeze(-1), points.float(), FAR)
        least, most = (speed * self.time_step for speed in self.speed_range)
        motion = point_motion(
            points, tagd.float(), valid, least=least, most=most, group_radius=self.group_radius
        )
        blocked = self._room(command.unsqueeze(1), points, motion)[:, 0] <= self.margin
        rows = blocked.nonzero()[:, 0]  # few: only for them the grid is tried
        if not len(rows):
            return command
        instead = self._most_similar(command[rows], points[rows], motion[rows])
        return command.index_put((rows,), instead)

    def _most_similar(self, command: Tensor, points: Tensor, motion: Tensor) -> Tensor:
        """Return ``[R, 2]``, for each command the most similar of those allowed in its place."""
        grid = self._grid.to(command).expand(len(command), -1, -1)
        candidates = torch.cat([command.unsqueeze(1), grid], dim=1)
        room = self._room(candidates, points, motion)
        most = room.amax(-1, keepdim=True)
        enough = torch.where(most > self.margin, self.margin, most - _SAME_ROOM)
        change = (candidates - command.unsqueeze(1)) / command.new_tensor(self._range)
        nearest = torch.where(room > enough, change.square().sum(-1), math.inf).argmin(-1)
        return candidates[torch.arange(len(command), device=command.device), nearest]

    def _room(self, commands: Tensor, points: Tensor, motion: Tensor) -> Tensor:
        """Return ``[N, S]`` m, the least between the hull and a point while a command is held."""
        times = commands.new_tensor(self.times)
        driven = commands.unsqueeze(-2) * times.unsqueeze(-1)  # m and rad since now
        places = advance_poses(commands.new_zeros(3), driven, 1.0)[..., :2]
        steps = [time / self.time_step for time in self.times]
        return room_along(places, points, motion, steps).amin(-1) - self.radius


def _check_sizes(
    horizon: float, time_step: float, checks_per_step: int, num_speeds: int, num_turn_rates: int
) -> int:
    """Return the number of checked times after now, before anything of that size is allocated.

    Raises:
        ValueError: If there are too many times or commands.
    """
    count = horizon / time_step * checks_per_step
    if count > _MAX_TIMES:
        raise ValueError(
            f"horizon={horizon}, time_step={time_step}, checks_per_step={checks_per_step}: "
            f"must be at most {_MAX_TIMES} times, horizon / time_step * checks_per_step"
        )
    if num_speeds * num_turn_rates > _MAX_COMMANDS:
        raise ValueError(
            f"num_speeds={num_speeds}, num_turn_rates={num_turn_rates}: "
            f"must be at most {_MAX_COMMANDS:,} commands, their product"
        )
    return math.ceil(count)
