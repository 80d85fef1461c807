"""Paired comparison of the metrics of a run with those of a reference."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from navrl.evaluation.metrics import METRICS, Metric
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

COLLISIONS = tuple(m.name for m in METRICS if m.is_ending and m.compared)
"""Kinds of collisions by object and at-fault party; their rates sum to the collision rate."""

_LATENCIES = ("median_ms", "p95_ms")
COMPARABLE = (
    *(m.name for m in METRICS if m.compared),
    *(f"latency_{name}" for name in _LATENCIES),
)
"""navrl's metrics in comparisons; success, collision and timeout have their own columns."""


@dataclass(frozen=True)
class MetricComparison:
    """Comparison of one metric of one run.

    Args:
        name: Column of ``episodes.csv``; ``latency_median_ms`` and ``latency_p95_ms`` are from
            ``latency.json``, as ``own`` without interval, and ``n`` is the number of decisions.
        unit: SI unit.
        better: ``higher`` or ``lower``; empty if neither.
        over: ``successes`` for metrics that grow with an episode's length, ``decisions`` for
            latencies, ``episodes`` for the others.
        own: Mean over the run's own successes or episodes, with bootstrap interval; for rates with
            Wilson interval.
        common: The same over the episodes in which all compared runs succeed. Empty for collisions,
            which do not occur there.
        difference: Mean of the run minus the reference over the episodes where both have a value
            (and both succeed, if ``over`` is successes), with a sign-flip test; ``None`` for the
            reference.
    """

    name: str
    unit: str
    better: str
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
    succeeded = [{index for index, ok in e.success.items() if ok} for e in evaluations]
    return set.intersection(*filter(None, succeeded)) if any(succeeded) else set()


def compare_metrics(
    evaluation: Evaluation, reference: Evaluation | None, finished: set[int]
) -> list[MetricComparison]:
    """Compare every metric that is to be compared and that the run has, the user's last.

    Args:
        evaluation: The run.
        reference: Reference run on the same episodes; ``None`` for the reference itself.
        finished: See :func:`finished_by_all`.

    Raises:
        ValueError: If the two did not play the same episodes.
    """
    if reference is not None:
        check_same_episodes([reference, evaluation])
    compared = [metric for metric in evaluation.metrics if metric.compared]
    found = [_compare(metric, evaluation, reference, finished) for metric in compared]
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
            better="lower",
            over="decisions",
            own=Estimate(found[name], math.nan, math.nan, found["calls"]),
            common=bootstrap_mean([]),
            difference=None,
        )
        for name in (_LATENCIES if found else ())
    ]


def _compare(
    metric: Metric, evaluation: Evaluation, reference: Evaluation | None, finished: set[int]
) -> MetricComparison:
    own, difference = _values(metric, evaluation), None
    if reference is not None:
        reference_values = _values(metric, reference)
        both = sorted(own.keys() & reference_values.keys())
        difference = paired_difference([own[i] for i in both], [reference_values[i] for i in both])
    estimate = _rate if metric.is_rate else bootstrap_mean
    common = [] if metric.name in COLLISIONS else [own[i] for i in sorted(finished & own.keys())]
    return MetricComparison(
        name=metric.name,
        unit=metric.unit,
        better=metric.better,
        over=metric.over,
        own=estimate(list(own.values())),
        common=estimate(common) if common else bootstrap_mean([]),
        difference=difference,
    )


def _values(metric: Metric, evaluation: Evaluation) -> Mapping[int, float]:
    values = evaluation.finite(metric.name)
    if metric.of_error is not None and values:  # older files have empty cells for failed episodes
        raised = [i for i, row in evaluation.episodes.items() if row["outcome"] == ERROR]
        values = values | dict.fromkeys(raised, metric.of_error)
    if metric.over == "successes":
        return {index: value for index, value in values.items() if evaluation.success[index]}
    return values
