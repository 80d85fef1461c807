"""Metrics of runs beside those of a reference, on episodes that can be compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from navrl.evaluation.metrics import METRICS
from navrl.evaluation.statistics import (
    Estimate,
    PairedDifference,
    bootstrap_mean,
    mcnemar_p_value,
    paired_difference,
)
from navrl.evaluation.stored import Evaluation, check_same_episodes

COMPARED = (
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
"""Metrics in comparisons; outcomes are compared as rates."""

_OF_FINISHED = ("time_to_goal_s", "path_length_m", "stalled_time_s", "time_without_progress_s")
_OF_FINISHED = (*_OF_FINISHED, "heading_change_rad")  # grow with the episode, so need a goal
_UNITS = {metric.name: metric.unit for metric in METRICS}


@dataclass(frozen=True)
class MetricComparison:
    """One metric of one run.

    Args:
        name: Column of ``episodes.csv``.
        unit: SI.
        over: ``successes`` of what grows with an episode's length, ``episodes`` of the rest.
        own: Mean over the run's own successes or episodes, with its bootstrap interval.
        common: The same over the episodes that all compared runs finish; of all runs the same ones.
        difference: Mean of the run less the reference over the episodes where both have a value
            (and both succeed, of what is ``over`` successes), by paired bootstrap; ``None`` of the
            reference.
    """

    name: str
    unit: str
    over: str
    own: Estimate
    common: Estimate
    difference: PairedDifference | None


def finished_by_all(evaluations: Sequence[Evaluation]) -> set[int]:
    """Return the episodes that every one of some runs wins.

    Raises:
        ValueError: If they did not play the same episodes.
    """
    check_same_episodes(evaluations)
    won = [{index for index, ok in e.success.items() if ok} for e in evaluations]
    return set.intersection(*won) if won else set()


def compare_metrics(
    evaluation: Evaluation, reference: Evaluation | None, finished: set[int]
) -> list[MetricComparison]:
    """Compare every metric of :data:`COMPARED` that the run has.

    Args:
        evaluation: The run.
        reference: What it is compared with, on the same episodes; ``None`` of the reference itself.
        finished: See :func:`finished_by_all`.

    Raises:
        ValueError: If the two did not play the same episodes.
    """
    if reference is not None:
        check_same_episodes([reference, evaluation])
    found = [_compare(name, evaluation, reference, finished) for name in COMPARED]
    return [comparison for comparison in found if comparison.own.n]


def success_difference(
    evaluation: Evaluation, reference: Evaluation
) -> tuple[PairedDifference, float]:
    """Return the difference in success rate over the same episodes, and its exact McNemar p-value.

    Raises:
        ValueError: If the two did not play the same episodes.
    """
    check_same_episodes([reference, evaluation])
    both = sorted(evaluation.success.keys() & reference.success.keys())
    first, second = ([run.success[index] for index in both] for run in (evaluation, reference))
    return paired_difference(first, second), mcnemar_p_value(first, second)


def _compare(
    name: str, evaluation: Evaluation, reference: Evaluation | None, finished: set[int]
) -> MetricComparison:
    own = _values(name, evaluation)
    difference = None
    if reference is not None:
        theirs = _values(name, reference)
        both = sorted(own.keys() & theirs.keys())
        difference = paired_difference([own[i] for i in both], [theirs[i] for i in both])
    return MetricComparison(
        name=name,
        unit=_UNITS[name],
        over="successes" if name in _OF_FINISHED else "episodes",
        own=bootstrap_mean(list(own.values())),
        common=bootstrap_mean([own[i] for i in sorted(finished & own.keys())]),
        difference=difference,
    )


def _values(name: str, evaluation: Evaluation) -> Mapping[int, float]:
    values = evaluation.finite(name)
    if name in _OF_FINISHED:
        return {index: value for index, value in values.items() if evaluation.success[index]}
    return values
