"""Summary of an approach over several training seeds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from navrl.evaluation.statistics import Estimate, stratified_bootstrap
from navrl.evaluation.stored import Evaluation

_SEED = re.compile(r"[_,-]?seed[_=](\d+)")


@dataclass(frozen=True)
class OverSeeds:
    """Summary of one value over training seeds.

    Args:
        name: ``success_rate``, ``collision_rate`` or ``time_to_goal_s`` (of successes).
        unit: SI unit; ``1`` for a rate.
        estimate: Interquartile mean of all seeds in all kinds of worlds, with its stratified
            bootstrap interval, NaN for fewer than 3 seeds; ``n`` is the number of seeds. Times are
            from the worlds in which every seed succeeds at least once; NaN without any.
        by_seed: Value of each seed over all its episodes, in the order of the seeds; NaN without
            any.
        worst: Worst value of ``by_seed``.
        best: Best value of ``by_seed``.
    """

    name: str
    unit: str
    estimate: Estimate
    by_seed: tuple[float, ...]
    worst: float
    best: float


@dataclass(frozen=True)
class SeedSummary:
    """Summary of an approach over its training seeds.

    Args:
        approach: Name without the seed.
        seeds: Training seeds of the runs, in order.
        success: Interquartile mean of the success rates of all seeds in all kinds of worlds, with
            its stratified bootstrap interval; ``n`` is the number of seeds.
        rates: Overall success rate of each seed, in the order of ``seeds``.
        episodes: Number of episodes of each run.
        metrics: Summaries of success, collisions and time to the goal.
    """

    approach: str
    seeds: tuple[int, ...]
    success: Estimate
    rates: tuple[float, ...]
    episodes: int
    metrics: tuple[OverSeeds, ...]


def split_seed(label: str) -> tuple[str, int | None]:
    """Return a run's approach and training seed: ``paper_seed_2`` is (``paper``, 2).

    Returns:
        The approach and its seed; the label itself and ``None`` if it has no seed.
    """
    match = _SEED.search(label)
    if match is None:
        return label, None
    return label[: match.start()] + label[match.end() :], int(match[1])


def over_seeds(evaluations: Mapping[str, Evaluation]) -> list[SeedSummary]:
    """Summarize every approach trained with two or more seeds.

    A run without seed in its name has seed 0, such as ``paper`` beside ``paper_seed_1``.

    Args:
        evaluations: Evaluations by label, all on the same episodes.

    Reference:
        Agarwal et al. 2021; :func:`navrl.evaluation.statistics.stratified_bootstrap`.
    """
    runs: dict[str, dict[int, Evaluation]] = {}
    for label, evaluation in evaluations.items():
        approach, seed = split_seed(label)
        if seed is not None:
            runs.setdefault(approach, {})[seed] = evaluation
    for approach, seeds in runs.items():
        if approach in evaluations:
            seeds.setdefault(0, evaluations[approach])
    return [_summary(name, seeds) for name, seeds in runs.items() if len(seeds) > 1]


def _summary(approach: str, by_seed: Mapping[int, Evaluation]) -> SeedSummary:
    seeds = tuple(sorted(by_seed))
    runs = [by_seed[seed] for seed in seeds]
    success = _over_seeds("success_rate", "1", runs, _successes)
    collision = _over_seeds("collision_rate", "1", runs, _collisions, lower_is_better=True)
    time = _over_seeds("time_to_goal_s", "s", runs, _times, lower_is_better=True)
    return SeedSummary(
        approach=approach,
        seeds=seeds,
        success=success.estimate,
        rates=success.by_seed,
        episodes=len(runs[0].success),
        metrics=(success, collision, time),
    )


def _successes(run: Evaluation) -> Mapping[int, float]:
    return {index: float(won) for index, won in run.success.items()}


def _collisions(run: Evaluation) -> Mapping[int, float]:
    rows = run.episodes.items()
    return {index: float(row["outcome"].startswith("collision")) for index, row in rows}


def _times(run: Evaluation) -> Mapping[int, float]:
    return {index: time for index, time in run.finite("time_s").items() if run.success[index]}


def _over_seeds(
    name: str,
    unit: str,
    runs: Sequence[Evaluation],
    values: Callable[[Evaluation], Mapping[int, float]],
    lower_is_better: bool = False,
) -> OverSeeds:
    known = [values(run) for run in runs]
    by_world = [_by_world(run, found) for run, found in zip(runs, known, strict=True)]
    scores = np.array([[_mean(world) for world in worlds] for worlds in by_world])
    scores = scores[:, np.isfinite(scores).all(axis=0)]
    by_seed = tuple(_mean(list(found.values())) for found in known)
    ends = [value for value in by_seed if math.isfinite(value)] or [math.nan]
    worst, best = (max(ends), min(ends)) if lower_is_better else (min(ends), max(ends))
    unknown = Estimate(math.nan, math.nan, math.nan, len(runs))
    estimate = stratified_bootstrap(scores) if scores.size else unknown
    return OverSeeds(name, unit, estimate, by_seed, worst, best)


def _by_world(run: Evaluation, values: Mapping[int, float]) -> list[list[float]]:
    """Return the values for each played kind of world, in order."""
    found: dict[str, list[float]] = {row["scenario"]: [] for row in run.episodes.values()}
    for index, value in values.items():
        found[run.episodes[index]["scenario"]].append(value)
    return [found[world] for world in sorted(found)]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else math.nan
