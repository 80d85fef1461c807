"""Playing of a suite in chunks, in one or several processes, with resuming."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, Protocol

from omegaconf import DictConfig
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

import navrl
from navrl.config import set_default
from navrl.evaluation import EpisodeRecord, evaluate
from navrl.evaluation.archive import RECORDINGS, EpisodeArchive
from navrl.evaluation.errors import ERRORS
from navrl.evaluation.results import EPISODES, SUMMARY
from navrl.evaluation.rollout import side_by_side
from navrl.evaluation.stored import LATENCY
from navrl.evaluation.unfinished import FinishedChunks
from navrl.factory.environment import num_threads, set_threads
from navrl.factory.metrics import make_metrics
from navrl.factory.overrides import check_options
from navrl.jobs.run_folder import result_values
from navrl.processes import import_in_server, worker_context
from navrl.progress_bar import progress_bar
from navrl.worlds import Scenario, ScenarioBatch

import_in_server(__name__)
_UNFINISHED = "unfinished"  # folder of finished chunks
Chunk = tuple[range, list[EpisodeRecord]]


class Playable(Protocol):
    """Interface of a policy with its environment."""

    policy: Callable[[TensorDictBase], TensorDictBase]
    env: TransformedEnv

    def close(self) -> None:
        """Close the environment, and the connection of a remote policy."""


def play_suite(
    cfg: DictConfig,
    scenarios: Sequence[Scenario],
    folder: Path,
    make: Callable[[DictConfig], Playable],
    key: str,
) -> list[EpisodeRecord]:
    """Play every scenario once.

    Episodes are split into fixed chunks of ``cfg.num_worlds``, each played as a batch, so neither
    the number of processes nor an interruption changes a result.

    Args:
        cfg: A composed ``conf/evaluate.yaml``.
        scenarios: Scenarios to play.
        folder: Folder of the evaluation, also for finished chunks and recordings.
        make: Builds policy and environment; called once per process.
        key: Other inputs that determine the records, e.g. hashes of policy and config.

    Returns:
        A record per scenario, in order.

    Raises:
        ValueError: If ``num_processes`` or ``recordings`` is not allowed.
        RuntimeError: If a process died, e.g. for lack of memory; finished chunks are retained.
    """
    check_options(cfg)
    finished = FinishedChunks(folder / _UNFINISHED, _key(cfg, scenarios, key))
    if finished.is_new:
        _remove_results(folder)
    chunks = side_by_side(len(scenarios), cfg.num_worlds)
    records = {chunk: finished.load(chunk) for chunk in chunks}
    missing = [chunk for chunk, found in records.items() if found is None]
    done = len(scenarios) - sum(map(len, missing))
    with progress_bar(len(scenarios), "episode", initial=done, enabled=cfg.progress_bar) as bar:
        arguments = (cfg, list(scenarios), folder, make)
        for chunk, found in _play(
            arguments, missing, min(cfg.get("num_processes", 1), len(missing))
        ):
            finished.save(chunk, found)
            records[chunk] = found
            bar.update(len(chunk))
    return [record for chunk in chunks for record in records[chunk]]


def finish(folder: Path) -> None:
    """Remove temporary files after the results are written."""
    FinishedChunks(folder / _UNFINISHED, "").clear()


def _remove_results(folder: Path) -> None:
    """Remove the files of an earlier evaluation, which do not belong to the new results."""
    for name in (SUMMARY, EPISODES, LATENCY):
        (folder / name).unlink(missing_ok=True)
    for name in (ERRORS, RECORDINGS):
        shutil.rmtree(folder / name, ignore_errors=True)


class _Player:
    """Policy with its environment and the archive of its episodes."""

    def __init__(
        self,
        cfg: DictConfig,
        scenarios: list[Scenario],
        folder: Path,
        make: Callable[[DictConfig], Playable],
    ) -> None:
        cfg, kept = cfg.copy(), cfg.get("recordings", "none")
        cfg.num_worlds = min(cfg.num_worlds, len(scenarios))  # more would play episodes twice
        self._batch, self._evaluated = ScenarioBatch.pack(scenarios), make(cfg)
        self._recorder, self._metrics = None, make_metrics(cfg)
        if kept != "none":
            place = folder / RECORDINGS
            self._recorder = EpisodeArchive(self._evaluated.env, scenarios, place, kept)

    def play(self, chunk: range) -> Chunk:
        env, policy = self._evaluated.env, self._evaluated.policy
        return chunk, evaluate(
            env,
            policy,
            self._batch,
            recorder=self._recorder,
            chunks=[chunk],
            metrics=self._metrics,
        )

    def close(self) -> None:
        self._evaluated.close()


def _play(arguments: tuple, chunks: list[range], processes: int) -> Iterator[Chunk]:
    """Yield chunks with their records as they are finished."""
    if not chunks:
        return
    if processes == 1:
        player = _Player(*arguments)
        yield from map(player.play, chunks)
        player.close()
        return
    cfg = arguments[0].copy()
    set_default(cfg, "num_threads", max(1, num_threads(cfg) // processes))
    with ProcessPoolExecutor(processes, worker_context(), _start, (cfg, *arguments[1:])) as workers:
        try:
            for job in as_completed([workers.submit(_play_in_worker, chunk) for chunk in chunks]):
                yield job.result()
        except BrokenProcessPool as error:
            raise RuntimeError(
                "a process of the evaluation died; the same command resumes after the finished "
                "episodes"
            ) from error
        finally:
            workers.shutdown(cancel_futures=True)


_player: _Player | None = None


def _start(*arguments: Any) -> None:
    """Prepare a worker process."""
    global _player
    set_threads(arguments[0])
    _player = _Player(*arguments)


def _play_in_worker(chunk: range) -> Chunk:
    assert _player is not None  # see _start
    return _player.play(chunk)


def _key(cfg: DictConfig, scenarios: Sequence[Scenario], key: str) -> str:
    """Return a key of an evaluation from all inputs that determine its records."""
    whole = hashlib.sha256(json.dumps(result_values(cfg), sort_keys=True, default=str).encode())
    whole.update(f"{navrl.__version__} {key} {cfg.get('recordings', 'none')}".encode())
    for scenario in scenarios:
        whole.update(scenario.to_json().encode())
    return whole.hexdigest()
