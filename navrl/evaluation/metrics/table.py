"""Table of all metrics; columns, comparisons, endings and docs follow from its rows.

A metric is two edits: its function, and its row here. A metric of the user's own is added by
configuration instead; see ``docs/extending.md``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from navrl.evaluation.metrics import efficiency, ending, motion, people, steering
from navrl.evaluation.metrics.metric import Metric
from navrl.evaluation.metrics.trajectory import Trajectory

_rate = partial(Metric, unit="1", is_rate=True)
_touched = partial(_rate, better="lower", compared=True)
_row = partial(Metric, compared=True)
_per_success = partial(Metric, compared=True, over="successes")

METRICS: tuple[Metric, ...] = (
    _rate("success", function=ending.success, better="higher", label="success", color="#009E73"),
    _rate("timeout", function=ending.timeout, better="lower", label="timeout", color="#0072B2"),
    _rate("collision", function=ending.collision, better="lower"),
    _touched(
        "collision_wall",
        function=ending.collision_wall,
        label="collision with a wall",
        color="#E69F00",
    ),
    _touched(
        "collision_furniture",
        function=ending.collision_furniture,
        label="collision with furniture",
        color="#F0E442",
    ),
    _touched(
        "moved_into_pedestrian",
        function=ending.moved_into_pedestrian,
        label="robot moved into a pedestrian",
        color="#D55E00",
    ),
    _touched(
        "hit_by_pedestrian",
        function=ending.hit_by_pedestrian,
        label="pedestrian moved into the robot",
        color="#CC79A7",
    ),
    _per_success("time_to_goal_s", "s", efficiency.time_to_goal, "lower"),
    _per_success("path_length_m", "m", efficiency.path_length, "lower"),
    _row("spl", "1", efficiency.spl, "higher", of_error=0.0),
    _row("stl", "1", efficiency.stl, "higher", of_error=0.0),
    _per_success("stalled_time_s", "s", efficiency.stalled_time, "lower"),
    _per_success("time_without_progress_s", "s", efficiency.time_without_progress, "lower"),
    _row("mean_speed_mps", "m/s", motion.mean_speed),
    Metric("max_speed_mps", "m/s", motion.max_speed),
    _row("mean_acceleration_mps2", "m/s^2", motion.mean_acceleration, "lower"),
    Metric("max_acceleration_mps2", "m/s^2", motion.max_acceleration, "lower"),
    _row("mean_jerk_mps3", "m/s^3", motion.mean_jerk, "lower"),
    Metric("max_jerk_mps3", "m/s^3", motion.max_jerk, "lower"),
    _per_success("heading_change_rad", "rad", motion.cumulative_heading_change, "lower"),
    _row("turn_reversal_share", "1", steering.turn_reversals, "lower"),
    Metric("speed_change_p90_mps", "m/s", steering.speed_change_p90, "lower"),
    _row("speed_change_p95_mps", "m/s", steering.speed_change_p95, "lower"),
    Metric("turn_rate_change_p90_radps", "rad/s", steering.turn_rate_change_p90, "lower"),
    _row("turn_rate_change_p95_radps", "rad/s", steering.turn_rate_change_p95, "lower"),
    Metric("max_turn_rate_radps", "rad/s", steering.max_turn_rate, "lower"),
    _per_success("turned_per_meter_radpm", "rad/m", steering.turned_per_meter, "lower"),
    _row("shielded_share", "1", steering.shielded),
    _row("min_pedestrian_distance_m", "m", people.min_pedestrian_distance, "higher"),
    _row("mean_pedestrian_distance_m", "m", people.mean_pedestrian_distance, "higher"),
    _row("beyond_0.45m_share", "1", people.beyond_intimate, "higher"),
    _row("beyond_1.2m_share", "1", people.beyond_personal, "higher"),
    _row("min_time_to_collision_s", "s", people.min_time_to_collision, "higher"),
)
"""Every metric of navrl, in the order of the columns."""

RENAMED = {"run_into": "hit_by_pedestrian"}
"""Names of metrics in files and commands of version 0.1, and their present names."""


def values_of_error(metrics: Iterable[Metric] = METRICS) -> dict[str, float]:
    """Return the values of an episode that raised an exception, by name.

    The episode counts as a failure: success and the metrics weighted by it are 0, and so are
    contacts and timeouts. The other metrics are undefined and omitted, since the trajectory was
    not recorded.

    Example:
        >>> values_of_error()["spl"]
        0.0
    """
    return {m.name: m.of_error for m in metrics if m.of_error is not None}


OF_ERROR = values_of_error()
"""Values of an episode that raised an exception, by name of navrl's metrics."""


def measure(trajectory: Trajectory, metrics: Sequence[Metric] = METRICS) -> dict[str, np.ndarray]:
    """Return metrics ``[E]`` of E episodes, by name.

    Args:
        trajectory: The episodes.
        metrics: Metrics to compute.

    Raises:
        ValueError: If a metric returns another shape.

    Example:
        >>> drive = Trajectory.of_positions([(0, 0), (0.1, 0), (0.2, 0)])
        >>> measure(drive)["time_to_goal_s"]
        array([0.4])
    """
    return {metric.name: metric.values(trajectory) for metric in metrics}


def markdown_table(metrics: Iterable[Metric] = METRICS) -> str:
    """Return the Markdown table of all metrics for the documentation.

    Example:
        >>> print(markdown_table(METRICS[:1]).splitlines()[0])
        | metric | unit | definition | source |
    """
    rows = ["| metric | unit | definition | source |", "|---|---|---|---|"]
    for metric in metrics:
        unit = metric.unit.replace("^2", "²").replace("^3", "³")
        cells = (text.replace("|", r"\|") for text in (metric.definition, metric.source))
        rows.append(f"| `{metric.name}` | {unit} | {' | '.join(cells)} |")
    return "\n".join(rows)
