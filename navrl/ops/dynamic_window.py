"""Scores of commands that are simulated for a short time among points that may move."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.ops.motion import room_along
from navrl.ops.unicycle import advance_poses


def score_commands(
    commands: Tensor,
    points: Tensor,
    motion: Tensor,
    waypoints: Tensor,
    *,
    radius: float,
    time_step: float = 0.2,
    horizon_steps: int = 7,
    margin: float = 0.05,
    clearance: float = 0.3,
    clearance_weight: float = 1.0,
    path_weight: float = 0.3,
) -> Tensor:
    """Score commands by the arc that the robot drives with each.

    A good arc comes close to the last waypoint, keeps clearance, and ends close to the path. Arcs
    with a contact have lower scores than all others, ordered by the time of the contact.

    Args:
        commands: ``[N, S, 2]`` (v, w), m/s and rad/s.
        points: ``[N, P, 2]`` m, robot frame; :data:`navrl.ops.motion.FAR` for no return.
        motion: ``[N, P, 2]`` m per step, predicted displacement of the points.
        waypoints: ``[N, F, 2]`` m, robot frame.
        radius: Radius of the robot, m.
        time_step: Time between two checked positions on an arc, s.
        horizon_steps: Number of checked positions.
        margin: Distance of the hull to points below which there is a contact, m.
        clearance: Clearance above which more is not rewarded, m.
        clearance_weight: Weight of clearance relative to distance to the waypoint.
        path_weight: Weight of distance to the path relative to distance to the waypoint.

    Returns:
        ``[N, S]``, larger is better.

    Example:
        >>> commands = torch.tensor([[[1.0, 0.0], [0.0, 0.0]]])
        >>> wall, ahead = torch.tensor([[[0.5, 0.0]]]), torch.tensor([[[1.5, 0.0]]])
        >>> still = torch.zeros(1, 1, 2)
        >>> score_commands(commands, wall, still, ahead, radius=0.2).argmax(-1)
        tensor([1])

    Reference:
        Fox, Burgard and Thrun, "The dynamic window approach to collision avoidance", 1997. Ours:
        waypoints in place of the goal's bearing, points in place of distances along the arc, and
        the motion of points.
    """
    time_s = torch.arange(1, horizon_steps + 1, device=commands.device) * time_step
    driven = commands.unsqueeze(-2) * time_s.unsqueeze(-1)  # m and rad from now
    arcs = advance_poses(torch.zeros(3, device=commands.device), driven, 1.0)[..., :2]
    room = room_along(arcs, points, motion, range(1, horizon_steps + 1)) - radius
    clear = (room > margin).cumprod(-1)  # until the first contact
    to_goal = (arcs - waypoints[:, None, -1:]).norm(dim=-1).amin(-1)
    off_path = torch.cdist(arcs[:, :, -1], waypoints).amin(-1)
    score = clearance_weight * room.amin(-1).clamp_max(clearance) - to_goal - path_weight * off_path
    return torch.where(clear[..., -1] > 0, score, clear.sum(-1) - 1e3 + room[..., 0])
