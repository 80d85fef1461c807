"""From a config to a policy, an environment that suits it, and results."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl.build.environment import make_device, make_env, make_navigation_env, num_threads
from navrl.build.inputs import evaluation_inputs
from navrl.build.playing import finish, play_suite
from navrl.build.run_folder import claim_folder, flat_values
from navrl.config import CONF_DIR, instantiate
from navrl.deploy import PolicyRunner
from navrl.evaluation import summarize, write_results
from navrl.evaluation.archive import missing_recordings
from navrl.evaluation.errors import write_errors
from navrl.evaluation.recording import Recording, record_episode
from navrl.evaluation.results import EPISODES, SUMMARY
from navrl.evaluation.stored import whole_results
from navrl.policies import ZOO, load_bundle, zoo_names
from navrl.worlds import Scenario

_PARTS = ("transforms", "lidar", "robot")  # that a bundle brings

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Contender:
    """A policy and the environment it is to be played in.

    Args:
        name: For the reader.
        policy: Writes a normalised action.
        env: Raw environment, the policy's own transforms, normalised actions.
    """

    name: str
    policy: Callable[[TensorDictBase], TensorDictBase]
    env: TransformedEnv


def bundle_folder(policy: str) -> Path | None:
    """Return the folder of the bundle that ``policy`` names, or ``None`` if it names none.

    A bundle's own folder, a training run's folder and a name in the zoo are bundles.
    """
    for folder in (Path(policy), Path(policy) / "policy", ZOO / policy):
        if (folder / "config.yaml").is_file() and (folder / "weights.safetensors").is_file():
            return folder
    return None


def make_contender(cfg: DictConfig, *, with_attention: bool = False) -> Contender:
    """Find the policy that ``cfg.policy`` names and build an environment for it.

    A bundle brings its own transforms, lidar and robot; a controller takes the config's.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        with_attention: Whether a bundle's actor writes its attention weights too.

    Raises:
        ValueError: If there is no such policy, listing those there are; or if the device is wrong.
        BundleError: If the bundle is damaged or not allowed.
    """
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return _controller(cfg)
    bundle = load_bundle(folder, cfg.allow)
    actor = bundle.actor_with_attention() if with_attention else bundle.actor
    actor = actor.to(make_device(cfg))
    return Contender(_policy_name(cfg), actor, _environment(_with_parts(cfg, bundle.config)))


def make_runner(cfg: DictConfig) -> PolicyRunner | None:
    """Return what runs the policy on a robot, as ``cfg.change`` has it; ``None`` of a controller.

    Raises:
        BundleError: If the bundle is damaged or not allowed.
    """
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return None
    bundle = load_bundle(folder, cfg.allow)
    local = _with_parts(cfg, bundle.config)
    parts = (instantiate(local[part]) for part in ("lidar", "robot"))
    return PolicyRunner(instantiate(local.transforms), bundle.actor, *parts)


def _with_parts(cfg: DictConfig, config: Mapping[str, Any]) -> DictConfig:
    """Return a copy of ``cfg`` with a bundle's own parts, changed as ``cfg.change`` says."""
    own = {part: config[part] for part in _PARTS}
    return _replaced(cfg, OmegaConf.merge(own, cfg.change))


def _policy_name(cfg: DictConfig) -> str:
    """Return what the policy is called: a training's folder by its own name."""
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return cfg.policy
    return folder.name if folder.name != "policy" else folder.parent.name


def policy_parts(cfg: DictConfig) -> dict[str, Any]:
    """Return what :func:`navrl.build.inputs.policy_hash` takes: a bundle's files or a node.

    Raises:
        ValueError: If there is no such policy.
    """
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return OmegaConf.to_container(_with_controller(cfg), resolve=True)["controller"]
    return {name: (folder / name).read_bytes() for name in ("config.yaml", "weights.safetensors")}


def _controller(cfg: DictConfig) -> Contender:
    if make_device(cfg).type != "cpu":
        raise ValueError(f"device={cfg.device}: policy={cfg.policy} plays on the CPU: device=cpu")
    local = _with_controller(cfg)
    return Contender(cfg.policy, instantiate(local.controller), _environment(local))


def _with_controller(cfg: DictConfig) -> DictConfig:
    """Return a copy of ``cfg`` with the controller that ``cfg.policy`` names as ``controller``.

    Raises:
        ValueError: If there is none, listing those there are.
    """
    file = CONF_DIR / "controller" / f"{cfg.policy}.yaml"
    if not file.is_file():
        known = sorted(path.stem for path in file.parent.glob("*.yaml"))
        if cfg.policy in ("all", "zoo", "controllers"):
            raise ValueError(f"policy={cfg.policy}: several, which need a sweep: navrl-evaluate -m")
        raise ValueError(
            f"policy={cfg.policy}: no such bundle or controller; controllers: {known}, "
            f"zoo: {zoo_names()}, or the folder of a bundle or of a training run"
        )
    node = OmegaConf.merge(OmegaConf.load(file), cfg.change.get("controller", {}))
    return _replaced(cfg, {"controller": node})


def _replaced(cfg: DictConfig, parts: Mapping[str, DictConfig]) -> DictConfig:
    """Return a copy of ``cfg`` with whole nodes replaced, not merged into what was there."""
    copy = cfg.copy()
    OmegaConf.set_struct(copy, False)
    for name, node in parts.items():
        copy[name] = node
    return copy


def _environment(cfg: DictConfig) -> TransformedEnv:
    env = make_navigation_env(cfg, cfg.num_worlds, privileged=True)
    return make_env(env, instantiate(cfg.transforms))


def run_evaluation(cfg: DictConfig, folder: Path) -> dict:
    """Play ``cfg.suite`` with ``cfg.policy`` and write the results into ``folder``.

    Returns:
        The summary.
    """
    suite = instantiate(cfg.suite)
    scenarios = _scenarios(OmegaConf.to_yaml(cfg.suite, resolve=True), num_threads(cfg))
    bundle = bundle_folder(cfg.policy)
    attends = bundle is not None and cfg.get("recordings", "none") != "none"
    make = partial(make_contender, with_attention=attends)
    determined_by = evaluation_inputs(cfg, policy_parts(cfg))
    records = play_suite(cfg, scenarios, folder, make, json.dumps(determined_by))
    summary = summarize(
        records,
        policy=_policy_name(cfg),
        suite=suite.name,
        suite_hash=suite.hash(scenarios),
        suite_version=suite.version,
        simulator=cfg.simulator["_target_"].rpartition(".")[2],
    )
    if cfg.change:
        summary = {**summary, "change": dict(flat_values(cfg.change))}
    write_errors(folder, records, scenarios)
    summary = write_results(folder, records, {**summary, **determined_by})
    finish(folder)
    return summary


@lru_cache(maxsize=16)
def _scenarios(suite: str, num_workers: int) -> list[Scenario]:
    """Generate a suite's scenarios once for all policies of a sweep: they take a fifth of its time.

    Args:
        suite: Its resolved configuration as YAML.
        num_workers: Processes that share the work.
    """
    return instantiate(OmegaConf.create(suite)).scenarios(num_workers=num_workers)


def finished_evaluation(cfg: DictConfig, folder: Path) -> dict | None:
    """Return the summary of the evaluation in ``folder`` if it needs no repetition.

    Raises:
        ValueError: If ``folder`` holds an evaluation of another configuration.
    """
    claim_folder(cfg, folder)
    return unchanged_evaluation(cfg, folder)


def unchanged_evaluation(cfg: DictConfig, folder: Path) -> dict | None:
    """Return the summary in ``folder`` if the same would be played again with the same result.

    Policy, configuration and code are compared by their hashes, and the episodes with theirs, so
    neither the time of a file nor a part of one counts. What is missing or differs is logged.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        folder: Of the evaluation.
    """
    if not (folder / SUMMARY).exists():
        return None
    summary = whole_results(folder)
    if summary is None:
        differs = [f"{SUMMARY} or {EPISODES} is missing or damaged"]
    else:
        known = evaluation_inputs(cfg, policy_parts(cfg))
        differs = [name for name, value in known.items() if summary.get(name) != value]
        if missing_recordings(folder, cfg.get("recordings", "none")):
            differs.append("recordings are missing")
        if summary["errors"] == summary["episodes"]:
            differs.append("every episode raised")
    if differs:
        log.info("%s: played again: %s", folder, ", ".join(differs))
        return None
    return summary


def record(cfg: DictConfig) -> Recording:
    """Play episode ``cfg.episode`` of ``cfg.suite`` with ``cfg.policy`` and keep all of it.

    Raises:
        ValueError: If the suite has no such episode.
    """
    scenario = instantiate(cfg.suite).scenarios([cfg.episode])[0]
    is_bundle = bundle_folder(cfg.policy) is not None
    contender = make_contender(cfg, with_attention=is_bundle)
    recording = record_episode(contender.env, contender.policy, scenario)
    contender.env.close()
    return recording
