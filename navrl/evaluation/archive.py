"""Archive of an evaluation's recordings: all episodes or the failed ones."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl import keys
from navrl.envs.transformed import base_env
from navrl.evaluation.kept import KEPT, is_kept
from navrl.evaluation.recording import DECIDED, OBSERVED, Recording
from navrl.evaluation.results import EPISODES
from navrl.evaluation.rollout import ERROR, EpisodeRecord
from navrl.worlds import Scenario

RECORDINGS = "recordings"
"""Subfolder of an evaluation."""


def missing_recordings(folder: Path, keep: str) -> bool:
    """Return whether recordings required by ``keep`` are missing in an evaluation's folder.

    Args:
        folder: Folder of the evaluation, with ``episodes.csv``.
        keep: One of :data:`navrl.evaluation.kept.KEPT`.
    """
    if keep == "none":
        return False
    with (folder / EPISODES).open(newline="") as file:
        rows = [(int(row["index"]), row["outcome"]) for row in csv.DictReader(file)]
    wanted = [index for index, outcome in rows if outcome != ERROR and is_kept(outcome, keep)]
    return not all(_file(folder / RECORDINGS, index).is_file() for index in wanted)


def _file(folder: Path, index: int) -> Path:
    return folder / f"{index:06d}.npz"


class EpisodeArchive:
    """Recorder of all worlds, the ``recorder`` of :func:`navrl.evaluation.evaluate`.

    It does not affect the results.

    Args:
        env: Environment of the evaluation, with ``privileged=True``.
        scenarios: All played scenarios, by index.
        folder: Folder of the files ``<index>.npz``, see
            :class:`navrl.evaluation.recording.Recording`.
        keep: ``failures`` (all except successes) or ``all``.

    Raises:
        ValueError: If ``keep`` is neither.
    """

    def __init__(
        self,
        env: TransformedEnv,
        scenarios: Sequence[Scenario],
        folder: Path,
        keep: str = "all",
    ) -> None:
        if keep not in KEPT[1:]:
            raise ValueError(f"keep={keep}: must be one of {', '.join(KEPT[1:])}")
        self._env, self._scenarios, self._folder = env, scenarios, folder
        self._keep = keep
        self.begin(range(0))

    def begin(self, chunk: range) -> None:
        """Discard the steps collected before."""
        self._observed: list[dict[str, np.ndarray]] = []
        self._decided: list[dict[str, np.ndarray]] = []
        self._terms: list[dict[str, np.ndarray]] = []
        self._contact: list[np.ndarray] = []

    def __call__(self, stepped: TensorDictBase) -> None:
        """Add a batch of transitions."""
        after = stepped.get("next")
        if not self._observed:
            self._observed.append(_copies(stepped, OBSERVED))
        self._observed.append(_copies(after, OBSERVED))
        # The environment's action, after its transforms of the policy's action.
        command = self._env.transform.inv(stepped.exclude("next"))
        attention = [name for name in DECIDED if name != keys.ACTION]
        decided = {**_copies(stepped, attention), **_copies(command, [keys.ACTION])}
        self._decided.append(decided)
        terms = after.get(keys.REWARD_TERMS)
        self._terms.append(_copies(terms, terms.keys()))
        self._contact.append(_copies(after, [keys.CONTACT])[keys.CONTACT])

    def end(self, chunk: range, records: list[EpisodeRecord]) -> None:
        """Write the selected episodes."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for row, record in enumerate(records):
            if is_kept(record.outcome, self._keep):
                self._recording(row, record).save(_file(self._folder, record.index), compact=True)
        self.begin(range(0))

    def _recording(self, row: int, record: EpisodeRecord) -> Recording:
        base, scenario = base_env(self._env), self._scenarios[record.index]
        steps = record.steps
        terms = {name: value[:, 0] for name, value in _series(self._terms[:steps], row).items()}
        return Recording.of_episode(
            scenario,
            record.outcome,
            base,
            reward_terms=terms,
            contact=self._contact[steps - 1][row].item(),  # later rows belong to other contacts
            **_series(self._observed[: steps + 1], row),
            **_series(self._decided[:steps], row),
        )


def _copies(step: TensorDictBase, names: Iterable[str]) -> dict[str, np.ndarray]:
    found = {name: step.get(name, None) for name in names}
    return {k: v.detach().cpu().numpy().copy() for k, v in found.items() if v is not None}


def _series(steps: list[dict[str, np.ndarray]], row: int) -> dict[str, np.ndarray]:
    """Return one world's rows of every array, stacked over time."""
    return {name: np.stack([step[name][row] for step in steps]) for name in steps[0]}
