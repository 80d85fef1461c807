"""Table of all metrics with names and units, the columns of ``episodes.csv``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navrl.evaluation.metrics import efficiency, ending, motion, people
from navrl.evaluation.metrics.trajectory import Trajectory


@dataclass(frozen=True)
class Metric:
    """Metric: a function of trajectories with name and unit.

    Args:
        name: Column of ``episodes.csv``.
        unit: SI unit; ``1`` for a share or a flag.
        function: Maps E episodes to ``[E]`` values; NaN where undefined.
        better: ``higher`` or ``lower``; empty if neither.
        is_rate: Whether the value is 0 or 1 in each episode.
    """

    name: str
    unit: str
    function: Callable[[Trajectory], np.ndarray]
    better: str = ""
    is_rate: bool = False


METRICS: tuple[Metric, ...] = (
    Metric("success", "1", ending.success, "higher", True),
    Metric("timeout", "1", ending.timeout, "lower", True),
    Metric("collision", "1", ending.collision, "lower", True),
    Metric("collision_wall", "1", ending.collision_wall, "lower", True),
    Metric("collision_furniture", "1", ending.collision_furniture, "lower", True),
    Metric("moved_into_pedestrian", "1", ending.moved_into_pedestrian, "lower", True),
    Metric("run_into", "1", ending.run_into, "lower", True),
    Metric("time_to_goal_s", "s", efficiency.time_to_goal, "lower"),
    Metric("path_length_m", "m", efficiency.path_length, "lower"),
    Metric("spl", "1", efficiency.spl, "higher"),
    Metric("stl", "1", efficiency.stl, "higher"),
    Metric("stalled_time_s", "s", efficiency.stalled_time, "lower"),
    Metric("time_without_progress_s", "s", efficiency.time_without_progress, "lower"),
    Metric("mean_speed_mps", "m/s", motion.mean_speed),
    Metric("max_speed_mps", "m/s", motion.max_speed),
    Metric("mean_acceleration_mps2", "m/s^2", motion.mean_acceleration, "lower"),
    Metric("max_acceleration_mps2", "m/s^2", motion.max_acceleration, "lower"),
    Metric("mean_jerk_mps3", "m/s^3", motion.mean_jerk, "lower"),
    Metric("max_jerk_mps3", "m/s^3", motion.max_jerk, "lower"),
    Metric("heading_change_rad", "rad", motion.cumulative_heading_change, "lower"),
    Metric("min_pedestrian_distance_m", "m", people.min_pedestrian_distance, "higher"),
    Metric("mean_pedestrian_distance_m", "m", people.mean_pedestrian_distance, "higher"),
    Metric("beyond_0.45m_share", "1", people.beyond_intimate, "higher"),
    Metric("beyond_1.2m_share", "1", people.beyond_personal, "higher"),
    Metric("min_time_to_collision_s", "s", people.min_time_to_collision, "higher"),
)
"""Every metric, in the order of the columns."""

OF_ERROR = {m.name: 0.0 for m in METRICS if m.is_rate or m.name in ("spl", "stl")}
"""Values assigned to episodes that failed with an exception; all other metrics are undefined."""


def measure(trajectory: Trajectory) -> dict[str, np.ndarray]:
    """Return all metrics ``[E]`` of E episodes, by name."""
    return {metric.name: metric.function(trajectory) for metric in METRICS}
