"""Construction of metrics from a configuration."""

from __future__ import annotations

from omegaconf import DictConfig

from navrl.config import instantiate
from navrl.evaluation.metrics import METRICS, Metric
from navrl.evaluation.results import COLUMNS


def make_metrics(cfg: DictConfig) -> tuple[Metric, ...]:
    """Return navrl's metrics, then those that ``cfg.metrics`` adds.

    Args:
        cfg: A composed ``conf/evaluate.yaml``; each node of ``metrics`` builds a
            :class:`navrl.evaluation.metrics.Metric`.

    Raises:
        ValueError: If a node builds something else, or the name is a column already.
    """
    found, taken = list(METRICS), set(COLUMNS)
    for key, node in (cfg.get("metrics") or {}).items():
        metric = instantiate(node)
        if not isinstance(metric, Metric):
            raise ValueError(
                f"metrics.{key}={type(metric).__name__}: must be a navrl.evaluation.metrics.Metric"
            )
        if metric.name in taken:
            raise ValueError(
                f"metrics.{key}: name={metric.name!r} is a column of episodes.csv already"
            )
        found.append(metric)
        taken.add(metric.name)
    return tuple(found)
