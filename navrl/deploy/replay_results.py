"""Results of a replay: recording, table over time and summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from navrl import keys
from navrl.deploy.replay import ReplayedTick
from navrl.deploy.runner import PolicyRunner
from navrl.deploy.safety import DriveState
from navrl.evaluation.recording import DECIDED, OBSERVED, REQUESTED, Recording
from navrl.evaluation.recording_checks import REPLAY
from navrl.files import csv_text
from navrl.worlds import Scenario

MOVING_M, MOVING_RAD = 0.05, np.radians(2.0)
"""Between two decisions of a moving pair, m or rad; less is not a test of the alignment."""
ALIGNED_M, ALIGNED_RAD = 0.1, np.radians(2.0)
"""Error up to which an alignment counts as right, m and rad."""
COLUMNS = (
    *("time_s", "state", "reason", "decided", "v", "w", "requested_v", "requested_w", "shielded"),
    *("recorded_v", "recorded_w", "measured_v", "measured_w", "x", "y", "yaw", "scan_age_s"),
    *("pose_age_s", "progress_m", "goal_distance_m", "icp_converged", "icp_inliers"),
    *("icp_error_m", "icp_error_rad", "inlier_share", "inlier_rms_m"),
    *("max_spatial_attention", "max_temporal_attention"),
)
"""Columns of the table; empty cells are values that are not known or not computed."""


def replay_table(ticks: Sequence[ReplayedTick]) -> str:
    """Return CSV with a row per tick; m, s and rad."""
    return csv_text(COLUMNS, map(_row, ticks))


def _row(tick: ReplayedTick) -> dict[str, object]:
    status = tick.status
    found: dict[str, object] = {"time_s": tick.time_s, "decided": int(tick.observation is not None)}
    found |= {"state": str(status.state), "reason": status.reason}
    found |= {"v": status.command.v, "w": status.command.w}
    pairs = {"requested": tick.requested, "recorded": tick.recorded, "measured": tick.measured}
    for name, pair in pairs.items():
        if pair is not None:
            found |= {f"{name}_v": pair[0], f"{name}_w": pair[1]}
    if status.pose is not None:
        found |= dict(zip(("x", "y", "yaw"), status.pose.tolist(), strict=True))
    for name in ("scan_age_s", "pose_age_s", "progress_m", "goal_distance_m"):
        found[name] = getattr(status, name)
    if tick.observation is not None:
        found["shielded"] = int(tick.is_shielded)
        found |= {"icp_converged": status.icp_converged, "icp_inliers": status.icp_inliers}
        if status.icp_quality is not None:
            found |= {"inlier_share": status.icp_quality[0], "inlier_rms_m": status.icp_quality[1]}
        for name in ("spatial_attention", "temporal_attention"):
            weights = getattr(status, name)
            found[f"max_{name}"] = None if weights is None else weights.max()
    if tick.icp_error is not None:
        found |= {"icp_error_m": tick.icp_error[0], "icp_error_rad": tick.icp_error[1]}
    return {name: _plain(value) for name, value in found.items()}


def _plain(value: object) -> object:
    """Return a cell: six decimals suffice and are the same on every machine."""
    if isinstance(value, bool | np.bool_):
        return int(value)
    if isinstance(value, float | np.floating):
        return f"{float(value):.6g}" if np.isfinite(value) else ""
    return value


def replay_summary(
    ticks: Sequence[ReplayedTick], rejected: Mapping[str, int], tick_s: float
) -> dict[str, Any]:
    """Return the figures of a replay.

    Args:
        ticks: States of the replay, at least one.
        rejected: Number of refused inputs by reason.
        tick_s: Time between two ticks, s.

    Returns:
        ``duration_s``; ``states`` with the seconds in each; numbers of ``decisions``, of
        ``shielded`` ones, of scans thinned and restarts of the history; ``alignment``;
        ``difference`` of the commands from the recorded ones at decisions while driving (root mean
        square); ``rejected``.
    """
    last = ticks[-1].status
    decided = [tick for tick in ticks if tick.observation is not None]
    states = Counter(str(tick.status.state) for tick in ticks)
    return {
        "duration_s": round(ticks[-1].time_s - ticks[0].time_s, 3),
        "states_s": {name: round(count * tick_s, 3) for name, count in states.most_common()},
        "decisions": last.num_steps,
        "shielded": sum(tick.is_shielded for tick in decided),
        "scans_thinned": last.num_thinned,
        "history_restarts": last.num_resets,
        "alignment": _alignment(decided),
        "difference": _difference(decided),
        "rejected": dict(sorted(rejected.items())),
    }


def _alignment(decided: Sequence[ReplayedTick]) -> dict[str, Any]:
    """Return how often the alignment agrees with the poses of the log."""
    pairs = [(*t.icp_error, *t.moved) for t in decided if t.icp_error and t.moved]
    if not pairs:
        return {"pairs": 0, "within": None, "moving": 0, "moving_within": None}
    error, turned, distance, turn = np.array(pairs).T
    moving = (distance > MOVING_M) | (turn > MOVING_RAD)
    right = (error <= ALIGNED_M) & (turned <= ALIGNED_RAD)
    share = round(float(right[moving].mean()), 4) if moving.any() else None
    found = {"pairs": len(pairs), "within": round(float(right.mean()), 4)}
    return {**found, "moving": int(moving.sum()), "moving_within": share}


def _difference(decided: Sequence[ReplayedTick]) -> dict[str, float] | None:
    """Return the root mean square difference to the recorded commands, or else to odometry."""
    pairs = [
        (*tick.status.command[:2], *(tick.recorded or tick.measured or ()))
        for tick in decided
        if tick.status.state is DriveState.DRIVE and (tick.recorded or tick.measured)
    ]
    if not pairs:
        return None
    rows = np.array(pairs)
    v, w = np.sqrt(np.square(rows[:, :2] - rows[:, 2:]).mean(axis=0)).tolist()
    return {"v_mps": round(v, 4), "w_radps": round(w, 4)}


# --- recording -----------------------------------------------------------------------------------


def replay_recording(
    ticks: Sequence[ReplayedTick], runner: PolicyRunner, name: str
) -> Recording | None:
    """Return a recording with a row per decision; None without any.

    Its poses are those of the log, so they do not follow the commands. There are no walls and
    pedestrians, since a log has none.

    Args:
        ticks: States of the replay.
        runner: The policy, with its lidar and robot.
        name: Name of the log.
    """
    decided = [tick for tick in ticks if tick.observation is not None]
    if not decided:
        return None
    series = {key: _stacked(decided, key) for key in (*OBSERVED, *DECIDED)}
    observed = {key: _extended(series[key]) for key in OBSERVED}
    count = len(decided)
    observed[keys.PEDESTRIAN_BOXES] = np.zeros((count + 1, 0, 5))
    action = np.array([tick.status.command[:2] for tick in decided], dtype=np.float32)
    asked = np.array([tick.requested for tick in decided], dtype=np.float32)
    attention = {key: series[key] for key in (keys.SPATIAL_ATTENTION, keys.TEMPORAL_ATTENTION)}
    path, pose = _driven_path(decided), observed[keys.POSE]
    assert pose is not None  # every observation has it
    lidar, steps = runner.lidar, np.diff([tick.time_s for tick in decided])
    return Recording(
        scenario=_scenario(name, pose[0], path).to_json(),
        outcome=REPLAY,
        time_step_s=float(np.median(steps)) if len(steps) else runner.time_step_s,
        robot_radius=float(runner.robot.radius),
        goal_radius=max(float(runner.limits.goal_radius), 1e-6),
        max_range=float(lidar.max_range),
        lidar_mount=np.array(lidar.mount),
        lidar_angles=np.array([lidar.angle_min, lidar.increment]),
        walls=np.zeros((0, 5)),
        path=path,
        goal=path[-1],
        reward_terms={},
        **{**observed, **attention, keys.ACTION: action, REQUESTED: asked},
    )


def _stacked(decided: Sequence[ReplayedTick], key: str) -> np.ndarray | None:
    """Return the values of a key over the decisions, None if the policy does not have it."""
    found = [tick.observation for tick in decided if tick.observation is not None]
    if not all(key in observation for observation in found):
        return None
    return np.stack([observation[key][0].numpy() for observation in found])


def _extended(values: np.ndarray | None) -> np.ndarray | None:
    """Return the values with the last row repeated, the one after the last decision."""
    return None if values is None else np.concatenate([values, values[-1:]])


def _driven_path(decided: Sequence[ReplayedTick]) -> np.ndarray:
    """Return the latest path without its padding, ``[P, 2]`` m, at least two points."""
    observation = decided[-1].observation
    assert observation is not None
    path = observation[keys.PATH][0].numpy()
    apart = np.append(True, (np.diff(path, axis=0) != 0.0).any(axis=1))
    kept = path[apart]
    return kept if len(kept) > 1 else np.repeat(kept, 2, axis=0)


def _scenario(name: str, pose: np.ndarray, path: np.ndarray) -> Scenario:
    return Scenario(
        suite="replay",
        seed=0,
        index=0,
        kind=name[-100:],
        boxes=np.zeros((0, 5)),
        start=np.array(pose, dtype=np.float64),
        goal=path[-1],
        path=path,
        pedestrians=(),
        noise_seed=0,
    )
