"""Evaluation: episodes, their outcomes and statistics."""

from navrl.evaluation.results import OUTCOMES, rates, summarize, write_results
from navrl.evaluation.rollout import ERROR, EpisodeRecord, Preparing, evaluate
from navrl.evaluation.statistics import wilson_interval

__all__ = [
    "ERROR",
    "OUTCOMES",
    "EpisodeRecord",
    "Preparing",
    "evaluate",
    "rates",
    "summarize",
    "wilson_interval",
    "write_results",
]
