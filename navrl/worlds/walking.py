"""Positions of scripted pedestrians as a function of time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from navrl.ops.gait import step_length

if TYPE_CHECKING:
    from navrl.worlds.batch import ScenarioBatch


def pedestrian_boxes(batch: ScenarioBatch, time_s: Tensor) -> Tensor:
    """Return the pedestrians' boxes at given times.

    The position along the route is a triangle wave of time: back and forth at constant speed. The
    yaw is the direction of travel; stationary pedestrians have yaw 0. A track is linear between its
    points; its pedestrian is absent before the first and after the last.

    Args:
        batch: S scenarios.
        time_s: ``[S]`` s since the start.

    Returns:
        ``[S, K, 5]`` float64 (cx, cy, hx, hy, yaw), world; NaN rows for absent pedestrians.
    """
    return pedestrian_states(batch, time_s)[..., :5]


def pedestrian_states(batch: ScenarioBatch, time_s: Tensor) -> Tensor:
    """Return the boxes of :func:`pedestrian_boxes` with the gait, ``[S, K, 7]`` float64.

    The last two columns are the phase of the gait, in steps, and the length of a step, m; see
    :mod:`navrl.ops.gait`.
    """
    states = _on_routes(batch, time_s)
    if bool(batch.ped_tracked.any()):
        states = torch.where(batch.ped_tracked[..., None], _on_tracks(batch, time_s), states)
    return states.masked_fill(~batch.ped_present.unsqueeze(-1), torch.nan)


def _on_routes(batch: ScenarioBatch, time_s: Tensor) -> Tensor:
    length = batch.route_arc[..., -1]
    traveled = batch.ped_offset + batch.ped_speed * time_s.double().unsqueeze(-1)
    phase = torch.remainder(traveled, (2 * length).clamp_min(1e-9))
    returning = phase > length
    arc = torch.where(returning, 2 * length - phase, phase).clamp_min(0.0)
    ends = batch.route_arc[..., 1:].contiguous()
    segment = torch.searchsorted(ends, arc.unsqueeze(-1)).clamp_max(ends.shape[-1] - 1)
    pair = segment.unsqueeze(-1).expand(*segment.shape, 2)
    first = batch.route.gather(-2, pair).squeeze(-2)
    second = batch.route.gather(-2, pair + 1).squeeze(-2)
    begin = batch.route_arc.gather(-1, segment).squeeze(-1)
    step = second - first
    size = step.norm(dim=-1)
    share = ((arc - begin) / size.clamp_min(1e-9)).clamp(0.0, 1.0)
    position = first + share.unsqueeze(-1) * step
    sign = torch.where(returning, -1.0, 1.0).double()
    yaw = torch.atan2(sign * step[..., 1], sign * step[..., 0])
    yaw = torch.where(batch.ped_static | (size == 0), 0.0, yaw)
    steps = step_length(batch.ped_speed).masked_fill(batch.ped_static, 0.0)
    gait = torch.where(batch.ped_static, 0.0, traveled / steps)
    columns = (position, batch.ped_half, yaw[..., None], gait[..., None], steps[..., None])
    return torch.cat(columns, dim=-1)


def _on_tracks(batch: ScenarioBatch, time_s: Tensor) -> Tensor:
    times = batch.route_arc.contiguous()
    now = time_s.double()[:, None, None].expand(*times.shape[:2], 1).contiguous()
    high = torch.searchsorted(times, now).clamp(1, times.shape[-1] - 1)
    gaits = track_gaits(batch.route, times)
    points = torch.cat((batch.route, gaits), dim=-1)
    rows = (high[..., None] - 1).expand(*high.shape, 5), high[..., None].expand(*high.shape, 5)
    before, after = (points.gather(-2, row).squeeze(-2) for row in rows)
    begin, end = times.gather(-1, high - 1), times.gather(-1, high)
    span = end - begin
    share = torch.where(span > 0.0, (now - begin) / span, 0.0)
    here = before + share * (after - before)
    columns = (here[..., :2], batch.ped_half, before[..., 3:4], here[..., 2:3], before[..., 4:])
    states = torch.cat(columns, dim=-1)
    is_over = (now < times[..., :1]) | (now > times[..., -1:])
    return states.masked_fill(is_over, torch.nan)


def track_gaits(positions: Tensor, times: Tensor) -> Tensor:
    """Return the gait at the points of tracks.

    Args:
        positions: ``[*B, R, 2]`` m, padded by repeating the last point.
        times: ``[*B, R]`` s, padded by repeating the last time.

    Returns:
        ``[*B, R, 3]`` float64: phase, in steps, and until the next point the yaw, rad, and the
        length of a step, m; a stationary pedestrian retains both.
    """
    step, span = positions.diff(dim=-2), times.diff(dim=-1)
    walked = torch.sqrt(step[..., 0] ** 2 + step[..., 1] ** 2)
    moves = (walked > 1e-6) & (span > 0.0)
    length = step_length(walked / torch.where(span > 0.0, span, 1.0))
    taken = torch.where(moves, walked / length, 0.0)
    phase = torch.nn.functional.pad(taken.cumsum(-1), (1, 0))
    yaw = torch.atan2(step[..., 1], step[..., 0])
    held = [_held(value, moves) for value in (yaw, length.masked_fill(~moves, 0.0))]
    return torch.stack((phase, *held), dim=-1)


def _held(values: Tensor, valid: Tensor) -> Tensor:
    """Return ``values [*B, R - 1]`` with those that are not valid replaced, and one more.

    The replacement is the last valid value before, or else the first one; 0 without any.
    """
    index = torch.arange(values.shape[-1], device=values.device).expand(values.shape)
    last = torch.where(valid, index, -1).cummax(-1).values
    first = torch.where(valid, index, values.shape[-1]).amin(-1, keepdim=True)
    chosen = torch.where(last < 0, first, last).clamp_max(values.shape[-1] - 1)
    held = torch.where(valid, values, 0.0).gather(-1, chosen)
    return torch.cat((held, held[..., -1:]), dim=-1)
