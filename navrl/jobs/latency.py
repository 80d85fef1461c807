"""How long a policy or controller thinks, on the episodes that it is judged by."""

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


def measure_latency(cfg: DictConfig, folder: Path) -> dict | None:
    """Play the first ``cfg.latency`` episodes again, one world on one thread, by the clock.

    A bundle is timed as on a robot, from scan, pose and path to the command
    (:class:`navrl.deploy.PolicyRunner`); a controller from what it reads to its action. What the
    clock says is different each time, so it has a file of its own; a folder that has one of as many
    episodes is not measured again.

    Args:
        cfg: A composed ``conf/evaluate.yaml``.
        folder: Of the evaluation, for ``latency.json``.

    Returns:
        What :func:`navrl.evaluation.metrics.controller_latency` does, and the number of
        ``episodes``; None if none was asked for.

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
    evaluated.env.close()
    found = {**controller_latency(clock.decisions), "episodes": count}
    write_json(file, found, indent=2)
    return found


def _measured(folder: Path) -> Mapping[str, float]:
    """Return what was measured before; nothing of a file that is missing or damaged."""
    try:
        return read_latency(folder) or {}
    except DamagedFileError:
        return {}


class _Clock:
    """A policy, with all else that it can, whose decisions are timed but for an episode's first."""

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
            sensed = {key: tensordict[key][0].numpy() for key in _SENSED}
            start = time.perf_counter()
            self._runner.act(**sensed)
            spent = time.perf_counter() - start
        if not self._is_first:
            self.decisions.append(spent)
        self._is_first = False
        return result

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)
