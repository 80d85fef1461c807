"""Origin of a recorded episode, from the files in its folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from navrl.evaluation.stored import Evaluation
from navrl.untrusted import read_yaml


def episode_folder(file: Path) -> Path:
    """Return the folder of an episode's run or evaluation, which stores it in ``recordings``."""
    folder = file.resolve().parent
    if folder.name == "recordings" or file.stem == "episode":
        return folder.parent
    return folder


def policy_of(file: Path) -> str | None:
    """Return the policy of an episode, from its evaluation or its run of ``navrl-play``."""
    evaluation = _evaluation_of(file)
    return _player(file.with_name(".hydra")) if evaluation is None else evaluation.label


def count_failures(files: Iterable[Path]) -> tuple[int, int] | None:
    """Return the numbers of failed and played episodes of the recordings' evaluations.

    ``None`` if a recording has no evaluation, since recordings may be of failed episodes only.
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
    """Return the policy of a run's command."""
    file = hydra / "config.yaml"
    asked = read_yaml(file, "delete it") if file.is_file() else {}
    if not asked.get("policy"):
        return None
    path = Path(str(asked["policy"]))
    name = path.parent.name if path.name == "policy" else path.name  # folder of a training run
    return f"{name}, changed" if asked.get("change") else name
