"""What an evaluation leaves: ``episodes.csv`` and ``summary.json``, byte for byte reproducible."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path

from navrl.envs import Outcome
from navrl.evaluation.rollout import ERROR, EpisodeRecord
from navrl.evaluation.statistics import wilson_interval

OUTCOMES = tuple(o.name.lower() for o in Outcome if o is not Outcome.RUNNING)
_COLUMNS = (
    "index",
    "scenario",
    "outcome",
    "steps",
    "time_s",
    "path_length_m",
    "min_pedestrian_distance_m",
    "run_into",
    "solved",
    "error",
)


def rates(records: Sequence[EpisodeRecord]) -> dict[str, float]:
    """Return the share of each outcome; they and ``error_rate`` sum to one."""
    names = (*OUTCOMES, ERROR)
    return {
        f"{name}_rate": sum(r.outcome == name for r in records) / len(records) for name in names
    }


def summarize(
    records: Sequence[EpisodeRecord], *, policy: str, suite: str, suite_hash: str, simulator: str
) -> dict:
    """Count outcomes and average the times of successes.

    Args:
        records: Every episode; an error counts as no success.
        policy: Name, for the reader.
        suite: Name.
        suite_hash: Of its scenarios.
        simulator: Name.

    Returns:
        Plain data, overall and for each kind of world: each rate with its 95 % Wilson interval;
        how many succeeded and their mean navigation time in s (``None`` without any); how many were
        run into, which are among the collisions with pedestrians; how many raised an error. Of a
        policy that plans ahead also how many it solved: those that nobody could win are among the
        others.

    Raises:
        ValueError: If there is no record.
    """
    if not records:
        raise ValueError("records: need at least one episode, got none")
    kinds = sorted({record.scenario for record in records})
    return {
        "policy": policy,
        "suite": suite,
        "suite_hash": suite_hash,
        "simulator": simulator,
        **_rates(records),
        "by_scenario": {kind: _rates([r for r in records if r.scenario == kind]) for kind in kinds},
    }


def write_results(folder: Path, records: Sequence[EpisodeRecord], summary: dict) -> None:
    """Write ``episodes.csv`` and ``summary.json`` into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, _COLUMNS, lineterminator="\n")
        writer.writeheader()
        for record in records:
            writer.writerow({name: _cell(getattr(record, name)) for name in _COLUMNS})
    (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")


def _rates(records: Sequence[EpisodeRecord]) -> dict:
    total = len(records)
    count = {name: sum(r.outcome == name for r in records) for name in (*OUTCOMES, ERROR)}
    count["collision"] = count["collision_pedestrian"] + count["collision_static"]
    result: dict = {"episodes": total}
    for name in ("success", "collision", "timeout", "collision_pedestrian", "collision_static"):
        low, high = wilson_interval(count[name], total)
        result[f"{name}_rate"] = round(count[name] / total, 6)
        result[f"{name}_interval"] = [round(low, 6), round(high, 6)]
    result["errors"] = count[ERROR]
    times = [r.time_s for r in records if r.outcome == "success"]
    result["successes"] = count["success"]
    result["run_into"] = sum(r.run_into for r in records)
    if any(r.solved is not None for r in records):
        result["solved"] = sum(bool(r.solved) for r in records)
    result["navigation_time_s"] = round(sum(times) / len(times), 4) if times else None
    return result


def _cell(value: object) -> object:
    """Write a value; ``None`` is an empty cell."""
    if isinstance(value, bool):
        return int(value)
    return f"{value:.6f}" if isinstance(value, float) else value
