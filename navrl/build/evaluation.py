"""From a config to a policy, an environment that suits it, and results."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl.build.environment import make_device, make_env, make_navigation_env, num_threads
from navrl.build.playing import finish, play_suite
from navrl.build.run_folder import claim_folder, flat_values
from navrl.config import CONF_DIR, instantiate
from navrl.evaluation import summarize, write_results
from navrl.evaluation.errors import write_errors
from navrl.evaluation.recording import Recording, record_episode
from navrl.evaluation.stored import finished_evaluation as finished_files
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
    own = {part: bundle.config[part] for part in ("transforms", "lidar", "robot")}
    return Contender(
        _policy_name(cfg), actor, _environment(_replaced(cfg, OmegaConf.merge(own, cfg.change)))
    )


def _policy_name(cfg: DictConfig) -> str:
    """Return what the policy is called: a training's folder by its own name."""
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return cfg.policy
    return folder.name if folder.name != "policy" else folder.parent.name


def _weights_hash(bundle: Path | None) -> str:
    """Tell a bundle's weights and configuration from others'."""
    if bundle is None:
        return ""
    files = (bundle / name for name in ("config.yaml", "weights.safetensors"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def _controller(cfg: DictConfig) -> Contender:
    files = {path.stem: path for path in (CONF_DIR / "controller").glob("*.yaml")}
    if cfg.policy not in files:  # never a path: that would build a node unchecked
        known = sorted(files)
        if cfg.policy in ("all", "zoo", "controllers"):
            raise ValueError(f"policy={cfg.policy}: several, which need a sweep: navrl-evaluate -m")
        raise ValueError(
            f"policy={cfg.policy}: no such bundle or controller; controllers: {known}, "
            f"zoo: {zoo_names()}, or the folder of a bundle or of a training run"
        )
    if make_device(cfg).type != "cpu":
        raise ValueError(f"device={cfg.device}: policy={cfg.policy} plays on the CPU: device=cpu")
    node = OmegaConf.merge(OmegaConf.load(files[cfg.policy]), cfg.change.get("controller", {}))
    local = _replaced(cfg, {"controller": node})
    return Contender(cfg.policy, instantiate(local.controller), _environment(local))


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
    records = play_suite(cfg, scenarios, folder, make, _weights_hash(bundle))
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
    write_results(folder, records, summary)
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
    bundle, found = bundle_folder(cfg.policy), finished_files(folder)
    if found is None:
        return None
    if cfg.get("recordings", "none") != "none" and not (folder / "recordings").is_dir():
        return None  # played without being kept
    if bundle and (bundle / "weights.safetensors").stat().st_mtime > (
        (folder / "summary.json").stat().st_mtime
    ):
        return None  # trained on since
    return dict(found.summary)


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
