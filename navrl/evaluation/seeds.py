"""One approach trained several times: its score and how much that is luck."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from navrl.evaluation.statistics import Estimate, stratified_bootstrap
from navrl.evaluation.stored import Evaluation

_SEED = re.compile(r"[_,-]?seed[_=](\d+)")


@dataclass(frozen=True)
class SeedSummary:
    """Success of an approach over its training seeds.

    Args:
        approach: Name without the seed.
        seeds: Of the runs, in order.
        success: Interquartile mean of the success rates of all seeds in all kinds of worlds, with
            its stratified bootstrap interval; ``n`` is the number of seeds.
        rates: Overall success rate of each seed, in the order of ``seeds``.
        episodes: Of each run.
    """

    approach: str
    seeds: tuple[int, ...]
    success: Estimate
    rates: tuple[float, ...]
    episodes: int


def split_seed(label: str) -> tuple[str, int | None]:
    """Return a run's approach and training seed: ``paper_seed_2`` is (``paper``, 2).

    Returns:
        The label itself and ``None`` if it names no seed.
    """
    match = _SEED.search(label)
    if match is None:
        return label, None
    return label[: match.start()] + label[match.end() :], int(match[1])


def over_seeds(evaluations: Mapping[str, Evaluation]) -> list[SeedSummary]:
    """Summarise every approach that was trained with two seeds or more.

    A run that names no seed is the one with seed 0, as ``paper`` beside ``paper_seed_1``.

    Args:
        evaluations: By label, all on the same episodes.

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


def _summary(approach: str, runs: Mapping[int, Evaluation]) -> SeedSummary:
    seeds = tuple(sorted(runs))
    scores = np.array([_success_by_world(runs[seed]) for seed in seeds])
    return SeedSummary(
        approach=approach,
        seeds=seeds,
        success=stratified_bootstrap(scores),
        rates=tuple(float(np.mean(list(runs[seed].success.values()))) for seed in seeds),
        episodes=len(runs[seeds[0]].success),
    )


def _success_by_world(evaluation: Evaluation) -> list[float]:
    worlds = {index: row["scenario"] for index, row in evaluation.episodes.items()}
    return [
        float(np.mean([evaluation.success[i] for i, kind in worlds.items() if kind == world]))
        for world in sorted(set(worlds.values()))
    ]
