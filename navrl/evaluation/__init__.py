"""Evaluation: episodes, their outcomes and statistics."""

from navrl.evaluation.comparison import (
    ComparisonRow,
    ComparisonTable,
    Evaluation,
    compare,
    find_evaluations,
)
from navrl.evaluation.results import OUTCOMES, rates, summarize, write_results
from navrl.evaluation.rollout import ERROR, EpisodeRecord, Preparing, evaluate
from navrl.evaluation.statistics import wilson_interval
from navrl.evaluation.tables import comma_separated, markdown, write_comparison

__all__ = [
    "ERROR",
    "OUTCOMES",
    "ComparisonRow",
    "ComparisonTable",
    "EpisodeRecord",
    "Evaluation",
    "Preparing",
    "comma_separated",
    "compare",
    "evaluate",
    "find_evaluations",
    "markdown",
    "rates",
    "summarize",
    "wilson_interval",
    "write_comparison",
    "write_results",
]
