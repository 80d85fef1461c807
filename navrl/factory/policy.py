"""Construction of a policy and its environment from a configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import torch
from hydra.utils import get_object
from omegaconf import DictConfig, ListConfig, OmegaConf
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl.config import compose, instantiate, options
from navrl.deploy import PolicyRunner, SafetyLimits
from navrl.deprecation import renamed_keys
from navrl.envs.transformed import base_env
from navrl.evaluation.rollout import check_known_future
from navrl.factory.environment import make_device, make_env, make_navigation_env
from navrl.factory.overrides import PARTS, check_policy
from navrl.factory.perturbation import perturbed_parts, with_policy_beams
from navrl.factory.policy_names import check_policy_name
from navrl.factory.values import flat_values
from navrl.policies import load_bundle
from navrl.policies.foreign import foreign_name, foreign_node
from navrl.policies.names import bundle_folder
from navrl.policies.sight import RestrictedPolicy, observed_sources


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

    @property
    def observes(self) -> list[str]:
        """Inputs that the policy may read: scan, pose, path, odometry, true state."""
        return observed_sources(self.policy, self.env)

    def close(self) -> None:
        """Close the environment, and the connection of a remote policy."""
        self.env.close()
        close = getattr(self.policy, "close", None)
        if close is not None:
            close()


def make_evaluated_policy(
    cfg: DictConfig,
    *,
    with_attention: bool = False,
    controller: Mapping[str, Any] | None = None,
) -> EvaluatedPolicy:
    """Build the policy named by ``cfg.policy`` and its environment.

    A bundle has its own transforms, lidar and robot; a controller uses those of the config, and is
    passed only what it declares to read (:class:`navrl.policies.sight.RestrictedPolicy`).
    ``cfg.perturbation`` and then ``cfg.change`` modify them.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        with_attention: Whether a bundle's actor also writes its attention weights.
        controller: Node of the controller named by ``cfg.policy``; looked up if ``None``. Processes
            not started by Hydra can look up navrl's own controllers only.

    Raises:
        ValueError: If the policy does not exist (the message lists all policies), the device is not
            allowed, or an override or change does not fit the policy.
        BundleError: If the bundle is damaged or not allowed.
    """
    folder = bundle_folder(cfg.policy)
    check_policy(cfg, is_bundle=folder is not None)
    if folder is None:
        return _controller(cfg, controller)
    bundle = load_bundle(folder, cfg.allow)
    actor = bundle.actor_with_attention() if with_attention else bundle.actor
    actor = actor.to(make_device(cfg))
    env = _environment(with_parts(cfg, bundle.config))
    _check_fit(cfg, actor, env)
    return EvaluatedPolicy(policy_name(cfg), actor, env)


@torch.no_grad()
def _check_fit(cfg: DictConfig, actor: Callable, env: TransformedEnv) -> None:
    """Check that the network fits the observations, by running it on zeros.

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
    """Return the runner of a bundle, perturbed and changed; ``None`` for a controller.

    It drives on every simulated scan, also on an empty one.

    Raises:
        BundleError: If the bundle is damaged or not allowed.
    """
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return None
    bundle = load_bundle(folder, cfg.allow)
    local = with_parts(cfg, bundle.config)
    transforms, lidar, robot = (instantiate(local[k]) for k in ("transforms", "lidar", "robot"))
    return PolicyRunner(transforms, bundle.actor, lidar, robot, SafetyLimits.simulated())


def with_parts(cfg: DictConfig, config: Mapping[str, Any]) -> DictConfig:
    """Return a copy of ``cfg`` with a bundle's parts, perturbed and changed."""
    return _replaced(cfg, _modified(cfg, {part: config[part] for part in PARTS}))


def policy_name(cfg: DictConfig) -> str:
    """Return the name of the policy; for a training run, the name of its folder."""
    folder = bundle_folder(cfg.policy)
    if folder is None:
        return cfg.policy if cfg.policy in options("controller") else foreign_name(cfg.policy)
    return folder.name if folder.name != "policy" else folder.parent.name


def _controller(cfg: DictConfig, node: Mapping[str, Any] | None) -> EvaluatedPolicy:
    if make_device(cfg).type != "cpu":
        raise ValueError(f"device={cfg.device}: must be cpu for policy={cfg.policy}")
    local = with_controller(cfg, node)
    controller, env = instantiate(local.controller), _environment(local)
    try:
        if not callable(controller):
            raise ValueError(
                f"policy={cfg.policy}: must build a callable from a TensorDict to one with "
                f"'action', got {type(controller).__name__}"
            )
        check_known_future(controller, base_env(env).simulator)
        restricted = RestrictedPolicy(cast(Callable, controller))
    except ValueError:
        env.close()
        raise
    return EvaluatedPolicy(policy_name(cfg), restricted, env)


def controller_node(policy: str) -> dict[str, Any] | None:
    """Return the node of the controller that ``policy`` names; ``None`` if it is a bundle.

    Controllers are the files of the group ``controller`` in the configuration directories: navrl's
    own and those of ``--config-dir``; others are :func:`navrl.policies.foreign.foreign_node`.

    Raises:
        ValueError: If it does not exist; the message lists all policies.
    """
    if bundle_folder(policy) is not None:
        return None
    check_policy_name(policy)  # never a path, which would build an unchecked node
    node = foreign_node(policy) if policy not in options("controller") else None
    if node is not None:
        return node
    node = compose("evaluate", [f"+controller={policy}"]).controller
    return cast(dict[str, Any], OmegaConf.to_container(node, resolve=False))


def controller_class(policy: str) -> type:
    """Return the class that the controller of that name builds, or the function.

    Raises:
        ValueError: If there is no such controller.
    """
    return get_object(controller_node(policy)["_target_"])


def with_controller(cfg: DictConfig, node: Mapping[str, Any] | None = None) -> DictConfig:
    """Return a copy of ``cfg`` with a controller as ``controller``, perturbed and changed.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        node: Node of the controller; the one named by ``cfg.policy`` if ``None``.

    Raises:
        ValueError: If there is none, listing those there are.
    """
    node = controller_node(cfg.policy) if node is None else node
    names = {*cfg.change, *perturbed_parts(cfg)}
    modified = {part: cfg[part] for part in PARTS if part in names}
    return _replaced(cfg, _modified(cfg, {"controller": renamed_keys(node), **modified}))


def _modified(cfg: DictConfig, parts: Mapping[str, Any]) -> DictConfig | ListConfig:
    """Return the parts modified by ``cfg.perturbation``, then by ``cfg.change``."""
    change = renamed_keys(OmegaConf.to_container(cfg.change, resolve=False))
    perturbed = with_policy_beams(cfg, parts, change)
    return _merged(cast(DictConfig, _merged(parts, perturbed)), change)


def _merged(parts: Mapping[str, Any], change: Mapping[str, Any]) -> DictConfig | ListConfig:
    """Return the parts with the changes merged; a part that becomes another class is replaced."""
    targets = {name: node.get("_target_") for name, node in change.items()}
    kept = {
        name: node
        for name, node in parts.items()
        if targets.get(name) in (None, node.get("_target_"))
    }
    return OmegaConf.merge(kept, change)


def _replaced(cfg: DictConfig, parts: DictConfig | ListConfig) -> DictConfig:
    """Return a copy of ``cfg`` with whole nodes replaced instead of merged."""
    copy = cfg.copy()
    OmegaConf.set_struct(copy, False)
    for name, node in parts.items():
        copy[name] = node
    return copy


def _environment(cfg: DictConfig) -> TransformedEnv:
    env = make_navigation_env(cfg, cfg.num_worlds, privileged=True)
    return make_env(env, instantiate(cfg.transforms))
