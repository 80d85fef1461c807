"""Metrics: pure functions of trajectories, each with unit, definition and source."""

from navrl.deprecation import renamed_attributes
from navrl.evaluation.metrics.efficiency import (
    duration,
    path_length,
    spl,
    stalled_time,
    stl,
    time_to_goal,
    time_without_progress,
)
from navrl.evaluation.metrics.ending import (
    collision,
    collision_furniture,
    collision_wall,
    hit_by_pedestrian,
    moved_into_pedestrian,
    success,
    timeout,
)
from navrl.evaluation.metrics.latency import controller_latency
from navrl.evaluation.metrics.metric import Metric
from navrl.evaluation.metrics.motion import (
    cumulative_heading_change,
    max_acceleration,
    max_jerk,
    max_speed,
    mean_acceleration,
    mean_jerk,
    mean_speed,
    speeds,
)
from navrl.evaluation.metrics.people import (
    beyond_intimate,
    beyond_personal,
    mean_pedestrian_distance,
    min_pedestrian_distance,
    min_time_to_collision,
)
from navrl.evaluation.metrics.steering import (
    max_turn_rate,
    shielded,
    speed_change_p90,
    speed_change_p95,
    turn_rate_change_p90,
    turn_rate_change_p95,
    turn_reversals,
    turned_per_meter,
)
from navrl.evaluation.metrics.table import (
    METRICS,
    OF_ERROR,
    markdown_table,
    measure,
    values_of_error,
)
from navrl.evaluation.metrics.trajectory import Trajectory

__getattr__ = renamed_attributes(__name__, {"run_into": "hit_by_pedestrian"})

__all__ = [
    "METRICS",
    "OF_ERROR",
    "Metric",
    "Trajectory",
    "beyond_intimate",
    "beyond_personal",
    "collision",
    "collision_furniture",
    "collision_wall",
    "controller_latency",
    "cumulative_heading_change",
    "duration",
    "hit_by_pedestrian",
    "markdown_table",
    "max_acceleration",
    "max_jerk",
    "max_speed",
    "max_turn_rate",
    "mean_acceleration",
    "mean_jerk",
    "mean_pedestrian_distance",
    "mean_speed",
    "measure",
    "min_pedestrian_distance",
    "min_time_to_collision",
    "moved_into_pedestrian",
    "path_length",
    "shielded",
    "speed_change_p90",
    "speed_change_p95",
    "speeds",
    "spl",
    "stalled_time",
    "stl",
    "success",
    "time_to_goal",
    "time_without_progress",
    "timeout",
    "turn_rate_change_p90",
    "turn_rate_change_p95",
    "turn_reversals",
    "turned_per_meter",
    "values_of_error",
]
