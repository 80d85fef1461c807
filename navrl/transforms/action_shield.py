"""Shield that replaces commands predicted to lead to a collision."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from tensordict import NestedKey
from torch import Tensor

from navrl import keys
from navrl.checks import check_positive
from navrl.deprecation import renamed_arguments
from navrl.ops.exporting import is_exporting
from navrl.ops.motion import (
    check_commands,
    check_descriptor_speeds,
    moving_points,
    sample_commands,
)
from navrl.transforms.action_map import ActionMap
from navrl.transforms.base_motion import IDEAL, Base, base_of
from navrl.transforms.observation_map import Keys, nested_keys
from navrl.transforms.shield_scene import (
    DISTANCE_TOLERANCE,
    Scene,
    check_grid,
    checked_times,
    required_distances,
)


class ActionShield(ActionMap):
    """Replace a command that leads to a collision by the most similar one that does not.

    A command is simulated for ``horizon``, while points of the scan stay in place or move with the
    velocity of their descriptor. At each checked time a point that approaches the robot's present
    position must be ``moving_margin`` away from the hull. The other points must be ``margin`` away,
    or, where the nearest of them is within ``margin`` already, no nearer than it is now, and no
    deeper than ``margin`` in the hull unless they are there. Points that are not finite are no
    returns. Among points that move, a command is simulated for ``moving_horizon``.

    A command that satisfies this passes unchanged. Otherwise it is replaced by the most similar
    command of a grid that does, where similarity is the difference in units of the limits' ranges.
    If there is none, the contact is delayed: of the commands whose first contact is latest, the
    requested one is kept if it is among them, or the one is selected that misses the required
    distances by least. So beside a wall a stop is kept, a pedestrian who walks up to the robot is
    evaded, and if that is impossible the robot does not drive into them.

    Without ``base`` the robot is assumed to have the commanded velocity at once. With one, its
    limits of acceleration and the delays of commands and scans are part of the simulation, and the
    horizon starts when the command takes effect.

    The action is (v, w) on both sides. The shield reads no privileged state and gives no guarantee:
    the robot can still hit an occluded obstacle or a pedestrian who changes direction.

    Args:
        radius: Radius of the robot, m.
        min_speed: Smallest forward speed of the robot, m/s.
        max_speed: Largest forward speed of the robot, m/s.
        max_turn_rate: Largest turn rate of the robot, rad/s.
        time_step: Time between two scans, s.
        horizon: Time for which a command is simulated, s.
        checks_per_step: Number of checked times in each time step.
        margin: Required clearance between hull and points, m.
        num_speeds: Number of speeds of the grid.
        num_turn_rates: Number of turn rates of the grid; odd, so that zero is one of them.
        min_descriptor_speed: Slower descriptors are treated as stationary, m/s; their motion is
            noise of scan and alignment.
        max_descriptor_speed: Faster descriptors are treated as mismatches, m/s.
        group_radius: Radius around a moving centroid within which points move with it, m.
        scan_keys: Points ``[*B, N, 2]`` m in the robot frame, returns ``[*B, N]`` bool, descriptors
            ``[*B, G, 4]`` m and validity of their halves ``[*B, G, 2]`` bool, at the time of the
            action.
        action_key: Key of the command ``[*B, 2]``, on both sides.
        base: How the robot follows commands; ``"environment"`` for the base of the environment or
            runner that the transform is a part of, ``None`` for one that follows them at once.
        base_keys: Velocity ``[*B, 2]`` and the last commands ``[*B, 2]``, latest first, as many as
            the steps of the longest delay; read with a base only.
        ahead: Whether points and velocity are those at the time when the command takes effect, of
            :class:`navrl.transforms.MotionPrediction`.
        moving_margin: Required clearance between hull and points that approach the robot's present
            position, m; ``None`` for ``margin``.
        moving_horizon: Time for which a command is simulated among points that move, s, at least
            ``horizon``, rounded up to a checked time; ``None`` for ``horizon``.

    Raises:
        ValueError: If a value is out of range, or later if a key is missing, or the environment has
            no known base.

    Example:
        >>> shield = ActionShield(radius=0.178, horizon=0.4)
        >>> wall = torch.tensor([[[0.4, 0.0]]]), torch.tensor([[True]])
        >>> static = torch.zeros(1, 1, 4), torch.zeros(1, 1, 2, dtype=torch.bool)
        >>> full_speed_ahead = torch.tensor([[1.0, 0.0]])
        >>> bool(shield.command(full_speed_ahead, *wall, *static)[0, 0] < 1.0)
        True

    Reference:
        Not in the paper. Shielding of learned policies: Alshiekh et al., "Safe Reinforcement
        Learning via Shielding", 2018. This implementation simulates the arcs of a dynamic window
        (Fox et al. 1997) among points that move with their TAGDs.
    """

    _grid: Tensor

    @renamed_arguments(least_speed="min_descriptor_speed", most_speed="max_descriptor_speed")
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
        min_descriptor_speed: float = 0.3,
        max_descriptor_speed: float = 1.5,
        group_radius: float = 0.3,
        scan_keys: Keys = (keys.POINTS, keys.RETURNS, keys.TAGD, keys.TAGD_VALID),
        action_key: NestedKey | list[str] = keys.ACTION,
        base: Base | Literal["environment"] | None = None,
        base_keys: Keys = (keys.VELOCITY, keys.COMMAND),
        ahead: bool = False,
        moving_margin: float | None = None,
        moving_horizon: float | None = None,
    ) -> None:
        names = ["points", "returns", "descriptors", "valid"]
        if base is not None:
            scan_keys = [*nested_keys(scan_keys), *nested_keys(base_keys)]
            names += ["velocity", *("command" for _ in scan_keys[5:])]
        super().__init__(names, scan_keys, action_key)
        if isinstance(base, str) and base != "environment":
            raise ValueError(f"base={base!r}: must be a Base, 'environment' or None")
        self.base, self.ahead = base, ahead
        check_positive(
            radius=radius,
            max_turn_rate=max_turn_rate,
            time_step=time_step,
            horizon=horizon,
            group_radius=group_radius,
            checks_per_step=checks_per_step,
        )
        check_commands(margin, min_speed, max_speed)
        check_grid(num_speeds, num_turn_rates)
        self.moving_margin = margin if moving_margin is None else moving_margin
        if not 0.0 <= self.moving_margin < math.inf:
            raise ValueError(f"moving_margin={moving_margin}: must be >= 0 (m), and finite")
        moving_horizon = horizon if moving_horizon is None else moving_horizon
        self.times = checked_times(horizon, moving_horizon, time_step, checks_per_step)
        self.radius, self.margin, self.time_step = radius, margin, time_step
        self.horizon = horizon
        self.speed_range = check_descriptor_speeds(min_descriptor_speed, max_descriptor_speed)
        self.group_radius = group_radius
        grid = sample_commands(min_speed, max_speed, max_turn_rate, num_speeds, num_turn_rates)
        self.register_buffer("_grid", grid, persistent=False)
        self._range = (max_speed - min_speed, 2.0 * max_turn_rate)

    def command(self, action: Tensor, *seen: Tensor) -> Tensor:
        """Return the shielded commands ``[*B, 2]``, m/s and rad/s.

        Args:
            action: ``[*B, 2]``, requested (v, w).
            seen: Points ``[*B, P, 2]`` m, returns ``[*B, P]`` bool, descriptors ``[*B, G, 4]`` m
                and validity of their halves ``[*B, G, 2]`` bool; with a base also its velocity
                and last commands, ``[*B, 2]`` each.
        """
        if not seen[0].shape[-2]:
            return action  # no point to avoid
        batch = action.shape[:-1]
        flat = (value.reshape(-1, *value.shape[len(batch) :]) for value in (action, *seen))
        return self._shielded(*flat).reshape(*batch, 2)

    def _shielded(
        self,
        command: Tensor,
        points: Tensor,
        returns: Tensor,
        tagd: Tensor,
        valid: Tensor,
        *state: Tensor,
    ) -> Tensor:
        scene = self._scene(points, returns, tagd, valid, state)
        asked = command.to(scene.points.dtype)
        blocked = scene.spare(asked.unsqueeze(1))[:, 0] <= 0.0
        if is_exporting():
            instead = self._most_similar_in_graph(blocked, asked, scene)
            return torch.where(blocked.unsqueeze(-1), instead.to(command.dtype), command)
        rows = blocked.nonzero()[:, 0]  # the grid is evaluated for the few blocked rows only
        if not len(rows):
            return command
        instead = self._most_similar(asked[rows], scene[rows])
        return command.index_put((rows,), instead.to(command.dtype))

    def _scene(
        self,
        points: Tensor,
        returns: Tensor,
        tagd: Tensor,
        valid: Tensor,
        state: Sequence[Tensor],
    ) -> Scene:
        points, motion = moving_points(
            points,
            returns,
            tagd,
            valid,
            speed_range=self.speed_range,
            time_step=self.time_step,
            group_radius=self.group_radius,
        )
        base = self._known_base()
        if base.scan_age_s:
            points = points + base.scan_age_s / self.time_step * motion
        velocity = state[0] if state else points.new_zeros(points.shape[0], 2)
        given = torch.stack(list(state[1:]), dim=1) if len(state) > 1 else velocity[:, None]
        margins = (self.radius, self.margin, self.moving_margin)
        required = required_distances(points, motion, *margins)
        times = self._times(base)
        until = times[-1] - self.times[-1] + self.horizon
        return Scene(points, motion, required, velocity, given, base, times, until, self.time_step)

    def _known_base(self) -> Base:
        if self.base is None:
            return IDEAL
        base = self.base if isinstance(self.base, Base) else base_of(self)
        return base.when_commands_apply() if self.ahead else base

    def _times(self, base: Base) -> list[float]:
        """Return the checked times, s: the horizon, later by the delay of the command."""
        late = math.ceil(max(base.command_delays_s) / self.times[0])
        return [self.times[0] * (k + 1) for k in range(late)] + [
            self.times[0] * late + time for time in self.times
        ]

    def _most_similar(self, command: Tensor, scene: Scene) -> Tensor:
        """Return the most similar allowed command for each command, ``[R, 2]``."""
        candidates = self._candidates(command)
        spare = scene.spare(candidates)
        stuck = (spare.amax(-1) <= 0.0).nonzero()[:, 0]
        if len(stuck):
            spare[stuck] = self._of_latest_contact(spare[stuck], candidates[stuck], scene[stuck])
        return self._nearest_allowed(command, candidates, spare)

    def _most_similar_in_graph(self, blocked: Tensor, command: Tensor, scene: Scene) -> Tensor:
        """Return :meth:`_most_similar` of the blocked rows in an exported graph.

        The grid is evaluated for all rows or for none, since a graph has no varying number of rows.
        """
        candidates = self._candidates(command)

        def spare_of(candidates: Tensor) -> Tensor:
            return scene.spare(candidates)

        def delayed(candidates: Tensor, spare: Tensor, stuck: Tensor) -> Tensor:
            latest = self._of_latest_contact(spare, candidates, scene)
            return torch.where(stuck.unsqueeze(-1), latest, spare)

        spare = torch.cond(blocked.any(), spare_of, _zeros, (candidates,))
        stuck = blocked & (spare.amax(-1) <= 0.0)
        spare = torch.cond(stuck.any(), delayed, _unchanged, (candidates, spare, stuck))
        return self._nearest_allowed(command, candidates, spare)

    def _candidates(self, command: Tensor) -> Tensor:
        """Return the requested command and the grid for each command, ``[R, S, 2]``."""
        grid = self._grid.to(command).expand(command.shape[0], -1, -1)
        return torch.cat([command.unsqueeze(1), grid], dim=1)

    def _nearest_allowed(self, command: Tensor, candidates: Tensor, spare: Tensor) -> Tensor:
        """Return the candidate most similar to the command among those of enough ``spare``."""
        largest = spare.amax(-1, keepdim=True)
        enough = torch.where(largest > 0.0, 0.0, largest - DISTANCE_TOLERANCE)
        change = (candidates - command.unsqueeze(1)) / command.new_tensor(self._range)
        nearest = torch.where(spare > enough, change.square().sum(-1), math.inf).argmin(-1)
        return candidates[torch.arange(command.shape[0], device=command.device), nearest]

    def _of_latest_contact(self, spare: Tensor, candidates: Tensor, scene: Scene) -> Tensor:
        """Return ``spare [R, S]`` of the candidates whose first contact is latest, else -inf.

        The requested command, candidate 0, is preferred if it is one of them.
        """
        until = scene.free_checks(candidates, self.radius)
        latest = until == until.amax(-1, keepdim=True)
        spare = torch.where(latest, spare, -math.inf)
        asked = torch.where(latest[:, :1], math.inf, spare[:, :1])
        return torch.cat([asked, spare[:, 1:]], dim=1)


def _zeros(candidates: Tensor) -> Tensor:
    return torch.zeros_like(candidates[..., 0])


def _unchanged(candidates: Tensor, spare: Tensor, stuck: Tensor) -> Tensor:
    return spare.clone()
