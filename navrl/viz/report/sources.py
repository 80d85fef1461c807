"""Sources of a report: evaluations, training logs and recorded episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from navrl.evaluation.recording import Recording
from navrl.evaluation.stored import Evaluation, find_evaluations
from navrl.viz.origins import episode_folder


@dataclass(frozen=True)
class Sources:
    """Files of a report.

    Args:
        folders: Searched folders.
        evaluations: Evaluations of any suite and simulator; of identical ones, one with recordings
            if there is any.
        logs: Files ``metrics.csv`` of trainings.
        recordings: Episodes by name, failed ones first, alternating between folders.
        files: File of each recording.
        num_recordings: Number of recordings found; ``recordings`` may have fewer.
    """

    folders: tuple[Path, ...]
    evaluations: tuple[Evaluation, ...]
    logs: tuple[Path, ...]
    recordings: tuple[tuple[str, Recording], ...]
    files: tuple[Path, ...]
    num_recordings: int

    def places(self) -> list[tuple[Evaluation, int] | None]:
        """Return the evaluation and episode index of each recording, ``None`` without one."""
        known = {e.folder.resolve(): e for e in self.evaluations}
        places = []
        for file in self.files:
            evaluation, stem = known.get(episode_folder(file)), file.stem
            index = int(stem) if stem.isdecimal() else None
            is_kept = evaluation is not None and index in evaluation.episodes
            places.append((evaluation, index) if is_kept else None)
        return places


def find_sources(folders: Iterable[str | Path], num_episodes: int) -> Sources:
    """Search some folders for results.

    Args:
        folders: At least one.
        num_episodes: Maximum number of recorded episodes.

    Raises:
        ValueError: If a folder does not exist, or no folder has results.
    """
    folders = tuple(Path(folder) for folder in folders)
    missing = [folder for folder in folders if not folder.is_dir()]
    if missing or not folders:
        raise ValueError(f"folder {missing[0]}: no such folder" if missing else "need a folder")
    evaluations = {
        e.folder: e
        for folder in folders
        if _has_evaluation(folder)
        for e in find_evaluations([folder])
    }
    logs = dict.fromkeys(file for folder in folders for file in sorted(folder.rglob("metrics.csv")))
    files = dict.fromkeys(file for folder in folders for file in sorted(folder.rglob("*.npz")))
    recordings = _in_order({file: Recording.load(file) for file in files})
    shown = list(recordings)[:num_episodes]
    if not evaluations and not logs and not recordings:
        places = ", ".join(map(str, folders))
        raise ValueError(f"{places}: no evaluation, no training and no recorded episode there")
    return Sources(
        folders,
        tuple(_without_copies(evaluations.values())),
        tuple(logs),
        tuple((_name(file), recordings[file]) for file in shown),
        tuple(shown),
        len(recordings),
    )


def _without_copies(evaluations: Iterable[Evaluation]) -> list[Evaluation]:
    """Remove repeated evaluations with the same result, such as a repetition for recording."""
    kept: dict[tuple, Evaluation] = {}
    for evaluation in evaluations:
        played = (evaluation.folder / "episodes.csv").read_bytes()
        same = (evaluation.setting, evaluation.label, played)
        if same not in kept or (evaluation.folder / "recordings").is_dir():
            kept[same] = evaluation
    return list(kept.values())


def _has_evaluation(folder: Path) -> bool:
    return any(file.with_name("episodes.csv").is_file() for file in folder.rglob("summary.json"))


def _in_order(recordings: dict[Path, Recording]) -> dict[Path, Recording]:
    """Order episodes with failed ones first, alternating between folders."""
    seen: Counter = Counter()
    order = {}
    for file, recording in recordings.items():
        won = recording.outcome == "success"
        seen[won, episode_folder(file)] += 1
        order[file] = (won, seen[won, episode_folder(file)])
    return {file: recordings[file] for file in sorted(recordings, key=order.__getitem__)}


def _name(file: Path) -> str:
    """Return the name of an episode: its folder, and its file unless that has the default name."""
    if file.stem == "episode":
        return file.resolve().parent.name
    return f"{episode_folder(file).name}/{file.stem}"
