"""Where a recorded episode comes from, as the files beside it tell."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from navrl.evaluation.stored import Evaluation
from navrl.untrusted import read_yaml


def episode_folder(file: Path) -> Path:
    """Return what an episode belongs to: an evaluation keeps its own in ``recordings``."""
    folder = file.resolve().parent
    if folder.name == "recordings" or file.stem == "episode":
        return folder.parent
    return folder


def policy_of(file: Path) -> str | None:
    """Return who played an episode, by the evaluation beside it or the run of ``navrl-play``."""
    evaluation = _evaluation_of(file)
    return _player(file.with_name(".hydra")) if evaluation is None else evaluation.label


def lost_and_played(files: Iterable[Path]) -> tuple[int, int] | None:
    """Return how many episodes were lost and played where some were recorded.

    ``None`` if one has no evaluation beside it: recordings may be of lost episodes alone.
    """
    evaluations = [_evaluation_of(file) for file in files]
    if None in evaluations:
        return None
    won = [won for e in {e.folder: e for e in evaluations}.values() for won in e.success.values()]
    return won.count(False), len(won)


def _evaluation_of(file: Path) -> Evaluation | None:
    folder = file.resolve().parent
    if folder.name == "recordings":
        folder = folder.parent
    summary = folder / "summary.json"
    if not summary.is_file() or not (folder / "episodes.csv").is_file():
        return None
    return Evaluation.load(folder)


def _player(hydra: Path) -> str | None:
    """Return the policy that a run was asked for."""
    file = hydra / "config.yaml"
    asked = read_yaml(file, "delete it") if file.is_file() else {}
    if not asked.get("policy"):
        return None
    path = Path(str(asked["policy"]))
    name = path.parent.name if path.name == "policy" else path.name  # of a training run
    return f"{name}, changed" if asked.get("change") else name
