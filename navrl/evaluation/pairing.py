"""Paired comparison of the metrics of a run with those of a reference."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from navrl.evaluation.metrics import METRICS, OF_ERROR
from navrl.evaluation.rollout import ERROR
from navrl.evaluation.statistics import (
    Estimate,
    PairedDifference,
    bootstrap_mean,
    mcnemar_p_value,
    paired_difference,
    wilson_interval,
)
from navrl.evaluation.stored import Evaluation, check_same_episodes

COLLISIONS = ("collision_wall", "collision_furniture", "moved_into_pedestrian", "run_into")
"""Kinds of collisions by object and at-fault party; their rates sum to the collision rate."""

COMPARED = (
    *COLLISIONS,
    "time_to_goal_s",
    "path_length_m",
    "spl",
    "stl",
    "stalled_time_s",
    "time_without_progress_s",
    "mean_speed_mps",
    "mean_acceleration_mps2",
    "mean_jerk_mps3",
    "heading_change_rad",
    "min_pedestrian_distance_m",
    "mean_pedestrian_distance_m",
    "beyond_0.45m_share",
    "beyond_1.2m_share",
    "min_time_to_collision_s",
)
"""Metrics in comparisons; success, collision and timeout are compared separately."""

_OF_FINISHED = ("time_to_goal_s", "path_length_m", "stalled_time_s", "time_without_progress_s")
_OF_FINISHED = (*_OF_FINISHED, "heading_change_rad")  # grow with the episode: successes only
_LATENCIES = ("median_ms", "p95_ms")
COMPARABLE = (*COMPARED, *(f"latency_{name}" for name in _LATENCIES))
"""Names of all metrics in comparisons."""
_UNITS = {metric.name: metric.unit for metric in METRICS}


@dataclass(frozen=True)
class MetricComparison:
    """Comparison of one metric of one run.

    Args:
        name: Column of ``episodes.csv``; ``latency_median_ms`` and ``latency_p95_ms`` are from
            ``latency.json``, as ``own`` without interval, and ``n`` is the number of decisions.
        unit: SI unit.
        over: ``successes`` for metrics that grow with an episode's length, ``decisions`` for
            latencies, ``episodes`` for the others.
        own: Mean over the run's own successes or episodes, with bootstrap interval; for
            :data:`COLLISIONS` with Wilson interval.
        common: The same over the episodes in which all compared runs succeed. Empty for collisions,
            which do not occur there.
        difference: Mean of the run minus the reference over the episodes where both have a value
            (and both succeed, if ``over`` is successes), with a sign-flip test; ``None`` for the
            reference.
    """

    name: str
    unit: str
    over: str
    own: Estimate
    common: Estimate
    difference: PairedDifference | None


def finished_by_all(evaluations: Sequence[Evaluation]) -> set[int]:
    """Return the episodes in which all runs succeed.

    A run without any success is excluded, since otherwise no episodes would remain.

    Raises:
        ValueError: If they did not play the same episodes.
    """
    check_same_episodes(evaluations)
    won = [{index for index, ok in e.success.items() if ok} for e in evaluations]
    return set.intersection(*filter(None, won)) if any(won) else set()


def compare_metrics(
    evaluation: Evaluation, reference: Evaluation | None, finished: set[int]
) -> list[MetricComparison]:
    """Compare every metric of :data:`COMPARED` that the run has.

    Args:
        evaluation: The run.
        reference: Reference run on the same episodes; ``None`` for the reference itself.
        finished: See :func:`finished_by_all`.

    Raises:
        ValueError: If the two did not play the same episodes.
    """
    if reference is not None:
        check_same_episodes([reference, evaluation])
    found = [_compare(name, evaluation, reference, finished) for name in COMPARED]
    return [comparison for comparison in found if comparison.own.n] + _latencies(evaluation)


def success_difference(
    evaluation: Evaluation, reference: Evaluation
) -> tuple[PairedDifference, float | None]:
    """Return the paired difference in success rate and its exact McNemar p-value.

    The p-value is ``None`` for fewer than :data:`navrl.evaluation.statistics.MIN_PAIRS` episodes.

    Raises:
        ValueError: If the two did not play the same episodes.
    """
    check_same_episodes([reference, evaluation])
    both = sorted(evaluation.success.keys() & reference.success.keys())
    first, second = ([run.success[index] for index in both] for run in (evaluation, reference))
    p_value = mcnemar_p_value(first, second)
    return paired_difference(first, second), None if math.isnan(p_value) else p_value


def _rate(flags: Sequence[float]) -> Estimate:
    """Return the share of ones, with its Wilson interval."""
    count, total = round(sum(flags)), len(flags)
    return Estimate(count / total if total else math.nan, *wilson_interval(count, total), total)


def _latencies(evaluation: Evaluation) -> list[MetricComparison]:
    found = evaluation.latency
    return [
        MetricComparison(
            name=f"latency_{name}",
            unit="ms",
            over="decisions",
            own=Estimate(found[name], math.nan, math.nan, found["calls"]),
            common=bootstrap_mean([]),
            difference=None,
        )
        for name in (_LATENCIES if found else ())
    ]


def _compare(
    name: str, evaluation: Evaluation, reference: Evaluation | None, finished: set[int]
) -> MetricComparison:
    own = _values(name, evaluation)
    difference, is_rate = None, name in COLLISIONS
    if reference is not None:
        theirs = _values(name, reference)
        both = sorted(own.keys() & theirs.keys())
        difference = paired_difference([own[i] for i in both], [theirs[i] for i in both])
    return MetricComparison(
        name=name,
        unit=_UNITS[name],
        over="successes" if name in _OF_FINISHED else "episodes",
        own=_rate(list(own.values())) if is_rate else bootstrap_mean(list(own.values())),
        common=bootstrap_mean([own[i] for i in sorted(finished & own.keys()) if not is_rate]),
        difference=difference,
    )


def _values(name: str, evaluation: Evaluation) -> Mapping[int, float]:
    values = evaluation.finite(name)
    if name in OF_ERROR and values:  # older files have empty cells for failed episodes
        raised = [i for i, row in evaluation.episodes.items() if row["outcome"] == ERROR]
        return values | {index: OF_ERROR[name] for index in raised}
    if name in _OF_FINISHED:
        return {index: value for index, value in values.items() if evaluation.success[index]}
    return values
