"""Evaluation job: play a suite with a policy and write the results."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

from navrl.config import instantiate
from navrl.envs.transformed import base_env
from navrl.evaluation import summarize, write_results
from navrl.evaluation.errors import ERRORS, first_error, write_errors
from navrl.evaluation.recorder import record_episode
from navrl.evaluation.recording import Recording
from navrl.factory.environment import num_threads
from navrl.factory.metrics import make_metrics
from navrl.factory.overrides import check_options, check_suite
from navrl.factory.perturbation import perturbation_summary
from navrl.factory.policy import (
    bundle_folder,
    controller_node,
    make_evaluated_policy,
    policy_name,
)
from navrl.factory.values import flat_values
from navrl.jobs.inputs import evaluation_inputs, policy_parts
from navrl.jobs.playing import finish, play_suite
from navrl.policies.controller import is_privileged
from navrl.worlds import Scenario, folder_hash


def check_evaluation(cfg: DictConfig) -> None:
    """Check an evaluation's configuration, except the policy, before any episode.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.

    Raises:
        ValueError: If a value is out of range, or an episode is not the frozen one.
    """
    check_options(cfg)
    check_suite(cfg)


def run_evaluation(cfg: DictConfig, folder: Path) -> dict:
    """Play ``cfg.suite`` with ``cfg.policy`` and write the results into ``folder``.

    Returns:
        The summary.
    """
    controller = controller_node(cfg.policy)
    start = _check_start(cfg, controller)
    suite = instantiate(cfg.suite)
    shown = cfg.get("progress_bar", False)
    scenarios = _scenarios(OmegaConf.to_yaml(cfg.suite, resolve=True), num_threads(cfg), shown)
    attends = controller is None and cfg.get("recordings", "none") != "none"
    make = partial(make_evaluated_policy, with_attention=attends, controller=controller)
    determined_by = evaluation_inputs(cfg, policy_parts(cfg))
    metrics = make_metrics(cfg)
    records = play_suite(
        with_room(cfg, scenarios), scenarios, folder, make, json.dumps(determined_by)
    )
    summary = summarize(
        records,
        policy=policy_name(cfg),
        suite=suite.name,
        suite_hash=suite.hash(scenarios),
        suite_version=None if start.is_reactive else suite.version,
        simulator=start.simulator,
        metrics=metrics,
        privileged=start.privileged,
        observes=start.observes,
    )
    summary |= perturbation_summary(cfg)
    if cfg.get("data") is not None:
        summary["data"] = {"folder": str(cfg.data), "sha256": folder_hash(cfg.data)}
    if cfg.change:
        summary = {**summary, "change": dict(flat_values(cfg.change))}
    write_errors(folder, records, scenarios)
    summary = write_results(folder, records, {**summary, **determined_by}, metrics)
    finish(folder)
    return summary


def with_room(cfg: DictConfig, scenarios: Sequence[Scenario]) -> DictConfig:
    """Return the configuration with a simulator that has rows for all pedestrians."""
    count = max((len(scenario.pedestrians) for scenario in scenarios), default=0)
    if count <= cfg.simulator.max_pedestrians:
        return cfg
    cfg = cfg.copy()
    cfg.simulator.max_pedestrians = count
    return cfg


class _Start(NamedTuple):
    """Facts about an evaluation before an episode is played.

    Args:
        simulator: Name, with that of the pedestrian model if it is reactive: other dynamics make
            other episodes, so no table has both.
        is_reactive: Whether the pedestrian model is reactive.
        privileged: Whether the policy reads the true state.
        observes: What the policy may read, :data:`navrl.policies.sight.SOURCES`.
    """

    simulator: str
    is_reactive: bool
    privileged: bool
    observes: list[str]


def _check_start(cfg: DictConfig, controller: dict[str, Any] | None) -> _Start:
    """Report configuration errors in this process, before scenarios are generated."""
    check_options(cfg)
    make_metrics(cfg)
    small = cfg.copy()
    small.num_worlds = 1
    evaluated = make_evaluated_policy(small, controller=controller)
    simulator = base_env(evaluated.env).simulator
    name, pedestrians = cfg.simulator["_target_"].rpartition(".")[2], simulator.pedestrians
    privileged, observes = is_privileged(evaluated.policy), evaluated.observes
    evaluated.close()
    if pedestrians.is_reactive:
        name = f"{name} with {type(pedestrians).__name__}"
    return _Start(name, pedestrians.is_reactive, privileged, observes)


@lru_cache(maxsize=16)
def _scenarios(suite: str, num_workers: int, progress: bool) -> list[Scenario]:
    """Return a suite's scenarios, cached for all policies of a sweep.

    Args:
        suite: Resolved configuration of the suite as YAML.
        num_workers: Processes that share the work.
        progress: Whether to show the progress.
    """
    made = instantiate(OmegaConf.create(suite))
    return made.scenarios(num_workers=num_workers, progress=progress)


def check_errors(cfg: DictConfig, summary: Mapping[str, Any], folder: Path) -> None:
    """Check that at least one episode was played.

    Raises:
        ValueError: If every episode raised an exception; with the first of them.
    """
    if summary["errors"] == summary["episodes"]:
        raise ValueError(
            f"policy={cfg.policy}: all {summary['errors']} episodes raised an error, the first: "
            f"{first_error(folder)}; tracebacks are in {folder / ERRORS}"
        )


def record(cfg: DictConfig) -> Recording:
    """Play and record episode ``cfg.episode`` of ``cfg.suite`` with ``cfg.policy``.

    Raises:
        ValueError: If the suite does not have the episode, or ``num_worlds`` is not 1.
    """
    if cfg.num_worlds != 1:
        raise ValueError(f"num_worlds={cfg.num_worlds}: one episode is played, must be 1")
    scenario = instantiate(cfg.suite).scenarios([cfg.episode])[0]
    cfg = with_room(cfg, [scenario])
    is_bundle = bundle_folder(cfg.policy) is not None
    evaluated = make_evaluated_policy(cfg, with_attention=is_bundle)
    recording = record_episode(evaluated.env, evaluated.policy, scenario)
    evaluated.close()
    return recording
