from .comparison import (
    ComparisonRow,
    ComparisonTable,
    compare,
    compare_folders,
)
from .metrics import METRICS, Trajectory, measure
from .results import OUTCOMES, rates, summarize, write_results
from .robustness import (
    RobustnessTable,
    robustness_markdown,
    robustness_tables,
    write_robustness,
)
from .rollout import ERROR, EpisodeRecord, Preparing, evaluate
from .spreadsheets import comma_separated
from .statistics import (
    bootstrap_mean,
    holm,
    interquartile_mean,
    mcnemar_p_value,
    paired_difference,
    stratified_bootstrap,
    wilson_interval,
)
from .stored import Evaluation, find_evaluations
from .tables import (
    markdown,
    metrics_markdown,
    write_comparison,
)

__all__ = [
    "ERROR",
    "METRICS",
    "OUTCOMES",
    "ComparisonRow",
    "ComparisonTable",
    "EpisodeRecord",
    "Evaluation",
    "Preparing",
    "RobustnessTable",
    "Trajectory",
    "bootstrap_mean",
    "comma_separated",
    "compare",
    "compare_folders",
    "evaluate",
    "find_evaluations",
    "holm",
    "interquartile_mean",
    "markdown",
    "mcnemar_p_value",
    "measure",
    "metrics_markdown",
    "paired_difference",
    "rates",
    "robustness_markdown",
    "robustness_tables",
    "stratified_bootstrap",
    "summarize",
    "wilson_interval",
    "write_comparison",
    "write_results",
    "write_robustness",
]
