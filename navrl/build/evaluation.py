"""From a config to a policy, an environment that suits it, and results."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl.build.environment import make_device, make_env, make_navigation_env, num_threads
from navrl.build.inputs import bundle_files, evaluation_inputs
from navrl.build.overrides import PARTS, check_options, check_policy, check_suite
from navrl.build.playing import finish, play_suite
from navrl.build.run_folder import flat_values
from navrl.config import CONF_DIR, instantiate
from navrl.deploy import PolicyRunner, SafetyLimits
from navrl.evaluation import summarize, write_results
from navrl.evaluation.errors import write_errors
from navrl.evaluation.recording import Recording, record_episode
from navrl.policies import ZOO, load_bundle, zoo_names
from navrl.worlds import Scenario


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
    ``cfg.change`` changes them.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        with_attention: Whether a bundle's actor writes its attention weights too.

    Raises:
        ValueError: If there is no such policy, listing those there are; if the device is wrong; or
            if something is overridden or changed that the policy does not have or cannot run with.
        BundleError: If the bundle is damaged or not allowed.
    """
    folder = bundle_folder(cfg.policy)
    check_policy(cfg, is_bundle=folder is not None)
    if folder is None:
        return _controller(cfg)
    bundle = load_bundle(folder, cfg.allow)
    actor = bundle.actor_with_attention() if with_attention else bundle.actor
    actor = actor.to(make_device(cfg))
    env = _environment(_with_parts(cfg, bundle.config))
    _check_fit(cfg, actor, env)
    return Contender(_policy_name(cfg), actor, env)


@torch.no_grad()
def _check_fit(cfg: DictConfig, actor: Callable, env: TransformedEnv) -> None:
    """Let the network act on zeros of the observations' shapes.

    Raises:
        ValueError: If it cannot, naming what was changed about the policy.
    """
    try:
        actor(env.full_observation_spec.zero())
    except (KeyError, RuntimeError) as error:
        env.close()
        changed = ", ".join(f"{name}={value}" for name, value in flat_values(cfg.change).items())
        raise ValueError(
            f"change: {changed or 'nothing'}: the network of policy={cfg.policy} does not fit the "
            f"observations ({str(error).splitlines()[0]})"
        ) from error


def make_runner(cfg: DictConfig) -> PolicyRunner | None:
    """Return what runs the policy on a robot, as ``cfg.change`` has it; ``None`` of a controller.

    It decides on every simulated scan, an empty one too.

    Raises:
        BundleError: If the bundle is damaged or not allowed.
    """
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return None
    bundle = load_bundle(folder, cfg.allow)
    local = _with_parts(cfg, bundle.config)
    parts = (instantiate(local[part]) for part in ("lidar", "robot"))
    limits = SafetyLimits.simulated()
    return PolicyRunner(instantiate(local.transforms), bundle.actor, *parts, limits)


def _with_parts(cfg: DictConfig, config: Mapping[str, Any]) -> DictConfig:
    """Return a copy of ``cfg`` with a bundle's own parts, changed as ``cfg.change`` says."""
    own = {part: config[part] for part in PARTS}
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
        return OmegaConf.to_container(_with_controller(cfg).controller, resolve=True)
    return bundle_files(folder)


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
    files = {path.stem: path for path in (CONF_DIR / "controller").glob("*.yaml")}
    if cfg.policy not in files:  # never a path: that would build a node unchecked
        known = sorted(files)
        if cfg.policy in ("all", "zoo", "controllers"):
            raise ValueError(f"policy={cfg.policy}: several, which need a sweep: navrl-evaluate -m")
        raise ValueError(
            f"policy={cfg.policy}: no such bundle or controller; controllers: {known}, "
            f"zoo: {zoo_names()}, or the folder of a bundle or of a training run"
        )
    changed = {part: cfg[part] for part in PARTS if part in cfg.change}
    return _replaced(
        cfg,
        OmegaConf.merge({"controller": OmegaConf.load(files[cfg.policy]), **changed}, cfg.change),
    )


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


def check_evaluation(cfg: DictConfig) -> None:
    """Check everything about an evaluation but its policy, before a training or any episode.

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
    _check_start(cfg)
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


def _check_start(cfg: DictConfig) -> None:
    """Report mistakes here, before scenarios are generated and in this process."""
    check_options(cfg)
    small = cfg.copy()
    small.num_worlds = 1
    make_contender(small).env.close()


@lru_cache(maxsize=16)
def _scenarios(suite: str, num_workers: int) -> list[Scenario]:
    """Generate a suite's scenarios once for all policies of a sweep: they take a fifth of its time.

    Args:
        suite: Its resolved configuration as YAML.
        num_workers: Processes that share the work.
    """
    return instantiate(OmegaConf.create(suite)).scenarios(num_workers=num_workers)


def record(cfg: DictConfig) -> Recording:
    """Play episode ``cfg.episode`` of ``cfg.suite`` with ``cfg.policy`` and keep all of it.

    Raises:
        ValueError: If the suite has no such episode, or ``num_worlds`` is not 1.
    """
    if cfg.num_worlds != 1:
        raise ValueError(f"num_worlds={cfg.num_worlds}: one episode is played, must be 1")
    scenario = instantiate(cfg.suite).scenarios([cfg.episode])[0]
    is_bundle = bundle_folder(cfg.policy) is not None
    contender = make_contender(cfg, with_attention=is_bundle)
    recording = record_episode(contender.env, contender.policy, scenario)
    contender.env.close()
    return recording
