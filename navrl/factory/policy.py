"""Construction of a policy and its environment from a configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl.config import CONF_DIR, instantiate
from navrl.deploy import PolicyRunner, SafetyLimits
from navrl.factory.environment import make_device, make_env, make_navigation_env
from navrl.factory.overrides import PARTS, check_policy
from navrl.factory.values import flat_values
from navrl.policies import ZOO, load_bundle, zoo_names


@dataclass(frozen=True)
class EvaluatedPolicy:
    """Policy with its environment for an evaluation.

    Args:
        name: Display name.
        policy: Writes a normalized action.
        env: Raw environment, the policy's own transforms, normalized actions.
    """

    name: str
    policy: Callable[[TensorDictBase], TensorDictBase]
    env: TransformedEnv


def bundle_folder(policy: str) -> Path | None:
    """Return the folder of the bundle named by ``policy``, or ``None``.

    Valid names are the folder of a bundle, the folder of a training run and a name in the zoo.
    """
    for folder in (Path(policy), Path(policy) / "policy", ZOO / policy):
        if (folder / "config.yaml").is_file() and (folder / "weights.safetensors").is_file():
            return folder
    return None


def make_evaluated_policy(cfg: DictConfig, *, with_attention: bool = False) -> EvaluatedPolicy:
    """Build the policy named by ``cfg.policy`` and its environment.

    A bundle has its own transforms, lidar and robot; a controller uses those of the config.
    ``cfg.change`` modifies them.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        with_attention: Whether a bundle's actor also writes its attention weights.

    Raises:
        ValueError: If the policy does not exist (the message lists all policies), the device is not
            allowed, or an override or change does not fit the policy.
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
    return EvaluatedPolicy(policy_name(cfg), actor, env)


@torch.no_grad()
def _check_fit(cfg: DictConfig, actor: Callable, env: TransformedEnv) -> None:
    """Run the network on zeros of the observations' shapes.

    Raises:
        ValueError: If it fails; the message has the changes of the policy.
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
    """Return the runner of a bundle, modified by ``cfg.change``; ``None`` for a controller.

    It drives on every simulated scan, also on an empty one.

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
    """Return a copy of ``cfg`` with a bundle's parts, modified by ``cfg.change``."""
    own = {part: config[part] for part in PARTS}
    return _replaced(cfg, OmegaConf.merge(own, cfg.change))


def policy_name(cfg: DictConfig) -> str:
    """Return the name of the policy; for a training run, the name of its folder."""
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return cfg.policy
    return folder.name if folder.name != "policy" else folder.parent.name


def _controller(cfg: DictConfig) -> EvaluatedPolicy:
    if make_device(cfg).type != "cpu":
        raise ValueError(f"device={cfg.device}: must be cpu for policy={cfg.policy}")
    local = with_controller(cfg)
    return EvaluatedPolicy(cfg.policy, instantiate(local.controller), _environment(local))


def with_controller(cfg: DictConfig) -> DictConfig:
    """Return a copy of ``cfg`` with the controller named by ``cfg.policy`` as ``controller``.

    Raises:
        ValueError: If it does not exist; the message lists all policies.
    """
    files = {path.stem: path for path in (CONF_DIR / "controller").glob("*.yaml")}
    if cfg.policy not in files:  # never a path, which would build an unchecked node
        known = sorted(files)
        if cfg.policy in ("all", "zoo", "controllers"):
            raise ValueError(
                f"policy={cfg.policy}: must be one policy; for several use navrl-evaluate -m"
            )
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
    """Return a copy of ``cfg`` with whole nodes replaced instead of merged."""
    copy = cfg.copy()
    OmegaConf.set_struct(copy, False)
    for name, node in parts.items():
        copy[name] = node
    return copy


def _environment(cfg: DictConfig) -> TransformedEnv:
    env = make_navigation_env(cfg, cfg.num_worlds, privileged=True)
    return make_env(env, instantiate(cfg.transforms))
