"""Result files of an evaluation: ``episodes.csv`` and ``summary.json``, reproducible.

The same command writes the same bytes. The schema is in ``docs/evaluation.md``.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from navrl.envs import Outcome
from navrl.evaluation.metrics import METRICS, Metric, values_of_error
from navrl.evaluation.rollout import ERROR, EpisodeRecord
from navrl.evaluation.statistics import bootstrap_mean, wilson_interval
from navrl.files import csv_text, write_json, write_text

EPISODES, SUMMARY = "episodes.csv", "summary.json"
"""Files of an evaluation."""
OUTCOMES = tuple(o.name.lower() for o in Outcome if o is not Outcome.RUNNING)
"""Outcomes of an episode, as named in the files; ``error`` is added."""
_COLUMNS = (
    "index",
    "scenario",
    "outcome",
    "steps",
    "time_s",
    "path_length_m",
    "min_pedestrian_distance_m",
    "hit_by_pedestrian",
    "solved",
    "noise_seed",
    "num_dynamic",
    "num_static",
    "pedestrian_speed_mps",
)
_RATES = ("success", "collision", "timeout", "collision_pedestrian", "collision_static")


def columns(metrics: Sequence[Metric] = METRICS) -> tuple[str, ...]:
    """Return the columns of ``episodes.csv``; more may be added before ``error``."""
    return (*_COLUMNS, *(m.name for m in metrics if m.name not in _COLUMNS), "error")


COLUMNS = columns()
"""Of ``episodes.csv`` with navrl's metrics alone; find them by name."""


def rates(records: Sequence[EpisodeRecord]) -> dict[str, float]:
    """Return the share of each outcome and ``error_rate``; they sum to one."""
    names = (*OUTCOMES, ERROR)
    return {
        f"{name}_rate": sum(r.outcome == name for r in records) / len(records) for name in names
    }


def summarize(
    records: Sequence[EpisodeRecord],
    *,
    policy: str,
    suite: str,
    suite_hash: str,
    simulator: str,
    suite_version: int | None = None,
    metrics: Sequence[Metric] = METRICS,
    privileged: bool = False,
    observes: Sequence[str] = (),
) -> dict:
    """Summarize the outcomes and metrics of an evaluation.

    Args:
        records: Records of all episodes; an error counts as a failure.
        policy: Name of the policy.
        suite: Name of the suite.
        suite_hash: Hash of its scenarios.
        simulator: Name of the simulator.
        suite_version: Version of the frozen episodes; ``None`` for other episodes.
        metrics: Metrics measured in each episode.
        privileged: Whether the policy reads the true state.
        observes: What the policy may read, e.g. scan, pose and path.

    Returns:
        Plain data, overall and for each kind of world: each rate with its 95 % Wilson interval; the
        numbers of successes with their mean time in s (``None`` without any), of episodes in which
        a pedestrian moved into the robot (part of the collisions with pedestrians), of errors and,
        for a planning policy, of solved episodes. ``metrics`` has every metric over all episodes
        and over the successes.

    Raises:
        ValueError: If there are no records.
    """
    kinds = sorted({record.scenario for record in records})
    return {
        "policy": policy,
        "privileged": privileged,
        "observes": list(observes),
        "suite": suite,
        "suite_hash": suite_hash,
        "suite_version": suite_version,
        "simulator": simulator,
        **_rates(records),
        "metrics": summarize_metrics(records, metrics),
        "by_scenario": {kind: _rates([r for r in records if r.scenario == kind]) for kind in kinds},
    }


def summarize_metrics(
    records: Sequence[EpisodeRecord], metrics: Sequence[Metric] = METRICS
) -> dict:
    """Summarize every metric over all episodes and over the successes.

    Args:
        records: Episodes; one that raised an exception has the values
            :data:`navrl.evaluation.metrics.OF_ERROR` in rates, ``spl`` and ``stl``, and is excluded
            from other metrics.
        metrics: Metrics measured in each episode.

    Returns:
        For each metric its ``unit``, which direction is ``better``, and for ``all`` and
        ``successes``: the number ``n`` of episodes with a finite value; their ``mean`` with its 95
        % ``interval`` (Wilson for rates, else :func:`navrl.evaluation.bootstrap_mean`; ``None`` if
        undefined) and their ``median``; ``None`` without values. A metric of the user's own has all
        of :meth:`navrl.evaluation.metrics.Metric.facts`.
    """
    raised = values_of_error(metrics)
    groups = {
        "all": [_values(r, raised) for r in records],
        "successes": [_values(r, raised) for r in records if r.outcome == "success"],
    }
    return {
        metric.name: {
            "unit": metric.unit,
            "better": metric.better,
            **({} if metric in METRICS else metric.facts()),
            **{
                group: _summary([values.get(metric.name) for values in rows], metric.is_rate)
                for group, rows in groups.items()
            },
        }
        for metric in metrics
    }


def write_results(
    folder: Path,
    records: Sequence[EpisodeRecord],
    summary: dict,
    metrics: Sequence[Metric] = METRICS,
) -> dict:
    """Write ``episodes.csv`` and then ``summary.json`` into ``folder``.

    Args:
        folder: Folder of the evaluation.
        records: Records of all episodes.
        summary: Result of :func:`summarize`.
        metrics: Metrics measured in each episode.

    Returns:
        The written summary, with ``episodes_hash``, the SHA-256 of ``episodes.csv``.
    """
    raised, flags = values_of_error(metrics), {m.name for m in metrics if m.is_rate}
    values = ({**_values(record, raised), **vars(record)} for record in records)
    header = columns(metrics)
    rows = ({name: _cell(row.get(name), name in flags) for name in header} for row in values)
    text = csv_text(header, rows)
    summary = {**summary, "episodes_hash": hashlib.sha256(text.encode()).hexdigest()}
    write_text(folder / EPISODES, text)
    write_json(folder / SUMMARY, summary, indent=2)
    return summary


def _values(record: EpisodeRecord, of_error: Mapping[str, float]) -> Mapping[str, float | None]:
    return of_error if record.outcome == ERROR else record.metrics


def _rates(records: Sequence[EpisodeRecord]) -> dict:
    total = len(records)
    if not total:
        raise ValueError("records=[]: must have at least one episode")
    count = {name: sum(r.outcome == name for r in records) for name in (*OUTCOMES, ERROR)}
    count["collision"] = count["collision_pedestrian"] + count["collision_static"]
    result: dict = {"episodes": total}
    for name in _RATES:
        low, high = wilson_interval(count[name], total)
        result[f"{name}_rate"] = round(count[name] / total, 6)
        result[f"{name}_interval"] = [round(low, 6), round(high, 6)]
    result["errors"] = count[ERROR]
    times = [r.time_s for r in records if r.outcome == "success"]
    result["successes"] = count["success"]
    result["hit_by_pedestrian"] = sum(r.hit_by_pedestrian for r in records)
    if any(r.solved is not None for r in records):
        result["solved"] = sum(bool(r.solved) for r in records)
    result["navigation_time_s"] = round(sum(times) / len(times), 4) if times else None
    return result


def _summary(values: Sequence[float | None], is_rate: bool) -> dict:
    known = np.array([value for value in values if value is not None], dtype=float)
    known = known[np.isfinite(known)]
    if len(known) == 0:
        return {"n": 0, "mean": None, "interval": None, "median": None}
    mean, low, high, count = bootstrap_mean(known)
    if is_rate:
        low, high = wilson_interval(int(known.sum()), count)
    return {
        "n": count,
        "mean": round(mean, 6),
        "interval": None if math.isnan(low) else [round(low, 6), round(high, 6)],
        "median": round(float(np.median(known)), 6),
    }


def _cell(value: object, is_flag: bool) -> object:
    """Format a value as a cell; ``None`` is an empty cell, and a flag is 0 or 1."""
    if value is not None and (is_flag or isinstance(value, bool)):
        return int(value)
    return f"{value:.6f}" if isinstance(value, float) else value
