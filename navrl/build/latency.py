"""How long a policy or controller thinks, on the episodes that it is judged by."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase

from navrl import keys
from navrl.benchmarks.measurement import frozen_objects, threads
from navrl.build.evaluation import bundle_folder, make_contender
from navrl.config import instantiate
from navrl.deploy import PolicyRunner, SafetyLimits
from navrl.evaluation import evaluate
from navrl.evaluation.metrics import controller_latency
from navrl.evaluation.stored import LATENCY
from navrl.worlds import ScenarioBatch

_SENSED = (keys.RANGES, keys.POSE, keys.PATH)


def measure_latency(cfg: DictConfig, folder: Path) -> dict | None:
    """Play the first ``cfg.latency`` episodes again, one world on one thread, by the clock.

    A bundle is timed as on a robot, from scan, pose and path to the command
    (:class:`navrl.deploy.PolicyRunner`); a controller from what it reads to its action. What the
    clock says is different each time, so it has a file of its own; a folder that has one is not
    measured again.

    Args:
        cfg: A composed ``conf/evaluate.yaml``.
        folder: Of the evaluation, for ``latency.json``.

    Returns:
        What :func:`navrl.evaluation.metrics.controller_latency` does; None if none was asked for.

    Raises:
        ValueError: If ``cfg.latency`` is negative.
    """
    count = cfg.get("latency", 0)
    if count < 0:
        raise ValueError(f"latency={count}: episodes to be timed, must be >= 0")
    file = folder / LATENCY
    if count == 0 or file.is_file():
        return json.loads(file.read_text()) if count else None
    scenarios = instantiate(cfg.suite).scenarios(range(min(count, cfg.suite.num_episodes)))
    cfg = cfg.copy()
    cfg.num_worlds = 1
    contender, bundle = make_contender(cfg), bundle_folder(cfg.policy)
    runner = (
        None
        if bundle is None
        else PolicyRunner.from_bundle(bundle, cfg.allow, SafetyLimits.simulated())
    )
    clock = _Clock(contender.policy, runner)
    with threads(1), frozen_objects(), torch.no_grad():
        for scenario in scenarios:
            clock.start_episode()
            evaluate(contender.env, clock, ScenarioBatch.pack([scenario]))
    contender.env.close()
    found = controller_latency(clock.decisions)
    file.write_text(json.dumps(found, indent=2) + "\n")
    return found


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
