"""Files of failed episodes, with the information to reproduce them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from navrl.evaluation.rollout import ERROR, EpisodeRecord
from navrl.files import write_json
from navrl.worlds import Scenario

ERRORS = "errors"
"""Subfolder of an evaluation."""


def first_error(folder: Path) -> str:
    """Return the last line of the first traceback in the folder of an evaluation."""
    first = min((folder / ERRORS).glob("*.json"))
    return json.loads(first.read_text())["traceback"][-1]


def write_errors(
    folder: Path, records: Sequence[EpisodeRecord], scenarios: Sequence[Scenario]
) -> list[Path]:
    """Write ``errors/<index>.json`` for each episode that raised an exception.

    Args:
        folder: Folder of the evaluation.
        records: Records of all episodes.
        scenarios: Played scenarios, by the records' indices.

    Returns:
        The files. Each has suite, seed and index, which determine the episode, the traceback, and
        the scenario for :meth:`navrl.worlds.Scenario.from_dict`.
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
