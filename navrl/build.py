"""Composition root: from a resolved config to worlds, environment, agent and trainer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numba
import torch
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModule
from torchrl.envs import ActionScaling, TransformedEnv

from navrl.config import instantiate
from navrl.envs import NavigationEnv
from navrl.worlds import ScenarioPool


def set_threads(count: int) -> None:
    """Let torch and the compiled kernels use ``count`` CPU threads.

    Raises:
        ValueError: If ``count`` is not between 1 and the number of cores.
    """
    limit = numba.config.NUMBA_NUM_THREADS
    if not 1 <= count <= limit:
        raise ValueError(f"num_threads={count}: must be between 1 and {limit} on this machine")
    torch.set_num_threads(count)
    numba.set_num_threads(count)


def make_env(
    cfg: DictConfig,
    num_worlds: int,
    scenarios: ScenarioPool | None = None,
    seed: int = 0,
    privileged: bool = False,
    transforms: object | None = None,
) -> TransformedEnv:
    """Build the simulator, the environment and its transforms.

    Args:
        cfg: Config with ``simulator``, ``robot``, ``lidar``, ``reward``, ``environment`` and
            ``transforms``.
        num_worlds: Batch size.
        scenarios: Where episodes are drawn from; ``None`` if they are set from outside.
        seed: Seed of the environment's generator.
        privileged: Whether the true state is observed too.
        transforms: Built transforms (a policy bundle's) in place of ``cfg.transforms``.

    Returns:
        An environment whose actions are normalised to [-1, 1].
    """
    env = NavigationEnv(
        instantiate(cfg.simulator, num_worlds=num_worlds),
        scenarios,
        rewards={name: instantiate(term) for name, term in cfg.reward.items()},
        privileged=privileged,
        seed=seed,
        **cfg.environment,
    )
    transformed = TransformedEnv(env, transforms or instantiate(cfg.transforms))
    transformed.append_transform(ActionScaling())
    return transformed


def observation_shapes(env: TransformedEnv) -> dict[str, list[int]]:
    """Return the feature shape (without batch) of every top-level observation of ``env``."""
    batch_dims = len(env.batch_size)
    return {
        key: list(spec.shape[batch_dims:])
        for key, spec in env.observation_spec.items()
        if isinstance(spec.shape, torch.Size) and len(spec.shape) > batch_dims
    }


def actor_node(cfg: DictConfig, shapes: Mapping[str, list[int]]) -> dict:
    """Return the plain config that rebuilds the actor anywhere: sizes included, no references."""
    network = OmegaConf.to_container(cfg.network, resolve=True)
    make = instantiate(cfg.network.encoder)
    needed = make(shapes=shapes).in_keys
    return {
        "_target_": "navrl.networks.make_actor",
        **network,
        "shapes": {key: list(shapes[key]) for key in needed},
        "action_size": 2,
    }


def make_agent(
    cfg: DictConfig, shapes: Mapping[str, list[int]]
) -> tuple[TensorDictModule, TensorDictModule]:
    """Build actor and critic for observations of the given shapes; seeds their weights."""
    torch.manual_seed(cfg.seed)
    node = actor_node(cfg, shapes)
    torch.manual_seed(cfg.seed)
    return instantiate(node), instantiate({**node, "_target_": "navrl.networks.make_critic"})
