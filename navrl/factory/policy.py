"""From a configuration to a policy and an environment that suits it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl.config import CONF_DIR, instantiate
from navrl.deploy import PolicyRunner, SafetyLimits
from navrl.factory.environment import make_device, make_env, make_navigation_env
from navrl.factory.overrides import PARTS, check_policy
from navrl.factory.policy_names import check_policy_name
from navrl.factory.values import flat_values
from navrl.policies import load_bundle
from navrl.policies.names import bundle_folder


@dataclass(frozen=True)
class EvaluatedPolicy:
    """A policy and the environment it is to be played in.

    Args:
        name: For the reader.
        policy: Writes a normalised action.
        env: Raw environment, the policy's own transforms, normalised actions.
    """

    name: str
    policy: Callable[[TensorDictBase], TensorDictBase]
    env: TransformedEnv


def make_evaluated_policy(cfg: DictConfig, *, with_attention: bool = False) -> EvaluatedPolicy:
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
    return EvaluatedPolicy(policy_name(cfg), actor, env)


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


def policy_name(cfg: DictConfig) -> str:
    """Return what the policy is called: a training's folder by its own name."""
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return cfg.policy
    return folder.name if folder.name != "policy" else folder.parent.name


def _controller(cfg: DictConfig) -> EvaluatedPolicy:
    if make_device(cfg).type != "cpu":
        raise ValueError(f"device={cfg.device}: policy={cfg.policy} plays on the CPU: device=cpu")
    local = with_controller(cfg)
    return EvaluatedPolicy(cfg.policy, instantiate(local.controller), _environment(local))


def with_controller(cfg: DictConfig) -> DictConfig:
    """Return a copy of ``cfg`` with the controller that ``cfg.policy`` names as ``controller``.

    Raises:
        ValueError: If there is none, listing those there are.
    """
    check_policy_name(cfg.policy)  # never a path: that would build a node unchecked
    file = CONF_DIR / "controller" / f"{cfg.policy}.yaml"
    changed = {part: cfg[part] for part in PARTS if part in cfg.change}
    return _replaced(
        cfg,
        OmegaConf.merge({"controller": OmegaConf.load(file), **changed}, cfg.change),
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
