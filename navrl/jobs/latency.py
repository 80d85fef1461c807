"""Latency of a policy or controller on the episodes of its evaluation."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase

from navrl import keys
from navrl.benchmarks.measurement import frozen_objects, threads
from navrl.config import instantiate
from navrl.deploy import PolicyRunner
from navrl.evaluation import evaluate
from navrl.evaluation.metrics import controller_latency
from navrl.evaluation.stored import LATENCY, read_latency
from navrl.factory.overrides import check_options
from navrl.factory.policy import make_evaluated_policy, make_runner
from navrl.files import write_json
from navrl.untrusted import DamagedFileError
from navrl.worlds import ScenarioBatch

_SENSED = (keys.RANGES, keys.POSE, keys.PATH)


def measure_latency(cfg: DictConfig, folder: Path) -> Mapping[str, float] | None:
    """Time the first ``cfg.latency`` episodes, played again in one world on one thread.

    A bundle is timed as on a robot, from scan, pose and path to the command
    (:class:`navrl.deploy.PolicyRunner`); a controller from its observation to its action. Latency
    is not reproducible, so it has a separate file; a folder with such a file of the same number of
    episodes is not measured again.

    Args:
        cfg: A composed ``conf/evaluate.yaml``.
        folder: Folder of the evaluation, for ``latency.json``.

    Returns:
        Result of :func:`navrl.evaluation.metrics.controller_latency` and the number of
        ``episodes``; ``None`` if ``cfg.latency`` is 0.

    Raises:
        ValueError: If ``cfg.latency`` is negative.
    """
    check_options(cfg)
    count, file = min(cfg.get("latency", 0), cfg.suite.num_episodes), folder / LATENCY
    if count == 0:
        return None
    known = _measured(folder)
    if known.get("episodes") == count:
        return known
    scenarios = instantiate(cfg.suite).scenarios(range(count))
    cfg = cfg.copy()
    cfg.num_worlds = 1
    evaluated, runner = make_evaluated_policy(cfg), make_runner(cfg)
    clock = _Clock(evaluated.policy, runner)
    with threads(1), frozen_objects(), torch.no_grad():
        for scenario in scenarios:
            clock.start_episode()
            evaluate(evaluated.env, clock, ScenarioBatch.pack([scenario]))
    evaluated.close()
    found = {**controller_latency(clock.decisions), "episodes": count}
    write_json(file, found, indent=2)
    return found


def _measured(folder: Path) -> Mapping[str, float]:
    """Return an earlier measurement; empty if the file is missing or damaged."""
    try:
        return read_latency(folder) or {}
    except DamagedFileError:
        return {}


class _Clock:
    """Wrapper of a policy that times its decisions, except the first of an episode."""

    def __init__(self, policy: Callable, runner: PolicyRunner | None) -> None:
        self._policy, self._runner = policy, runner
        self._is_first = True
        self.decisions: list[float] = []

    def start_episode(self) -> None:
        self._is_first = True
        if self._runner is not None:
            self._runner.reset()

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        start = time.perf_counter()
        result = self._policy(tensordict)
        spent = time.perf_counter() - start
        if self._runner is not None:
            sensed = {key: tensordict.get(key)[0].numpy() for key in _SENSED}
            start = time.perf_counter()
            self._runner.act(**sensed)
            spent = time.perf_counter() - start
        if not self._is_first:
            self.decisions.append(spent)
        self._is_first = False
        return result

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)
