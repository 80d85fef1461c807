"""Episodes that raised, with all it takes to raise them again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from navrl.evaluation.rollout import ERROR, EpisodeRecord
from navrl.files import write_json
from navrl.worlds import Scenario

ERRORS = "errors"
"""Folder within that of an evaluation."""


def write_errors(
    folder: Path, records: Sequence[EpisodeRecord], scenarios: Sequence[Scenario]
) -> list[Path]:
    """Write ``errors/<index>.json`` for each episode that raised.

    Args:
        folder: Of the evaluation.
        records: Every episode.
        scenarios: What was played, by the records' indices.

    Returns:
        The files: suite, seed and index, which determine the episode, the traceback, and the
        scenario itself for :meth:`navrl.worlds.Scenario.from_dict`.
    """
    files = []
    for record in records:
        if record.outcome != ERROR:
            continue
        scenario = scenarios[record.index]
        plain = {
            "suite": scenario.suite,
            "seed": scenario.seed,
            "index": scenario.index,
            "traceback": record.error.splitlines(),
            "scenario": scenario.to_dict(),
        }
        file = folder / ERRORS / f"{record.index:06d}.json"
        files.append(write_json(file, plain, indent=1))
    return files
