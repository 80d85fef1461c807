"""Construction of agents and trainers from a configuration; saving of policies."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, cast

import torch
from hydra.utils import get_class
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModule
from torchrl.envs import Transform, TransformedEnv

import navrl
from navrl.algos import Algorithm, Exploration
from navrl.algos.protocols import check_protocol
from navrl.config import instantiate
from navrl.deprecation import taken_argument
from navrl.evaluation import evaluate, rates
from navrl.factory.environment import (
    make_device,
    make_env,
    make_navigation_env,
    make_pool,
    make_training_env,
    on_cpu,
)
from navrl.factory.loggers import hparams, make_loggers, make_video
from navrl.factory.warm_start import is_resumed, start_actor, start_critic
from navrl.policies import save_bundle, saved_metrics
from navrl.training import Collector, Trainer
from navrl.training.interruption import shield_resource_tracker
from navrl.training.provenance import recorded_commands
from navrl.training.workers import WorkersCollector


def observation_shapes(env: TransformedEnv) -> dict[str, list[int]]:
    """Return the feature shape (without batch) of every top-level observation of ``env``."""
    batch_dims = len(env.batch_size)
    return {
        str(key): list(spec.shape[batch_dims:])
        for key, spec in env.observation_spec.items()
        if isinstance(spec.shape, torch.Size) and len(spec.shape) > batch_dims
    }


def actor_node(cfg: DictConfig, shapes: Mapping[str, list[int]]) -> dict:
    """Return the plain, self-contained config of the actor, including sizes."""
    network = _plain(cfg, "network")
    network.pop("attention", None)  # sizes referred to by the streams
    network.pop("critic", None)  # critic only
    make = instantiate(cfg.network.encoder)
    needed = make(shapes=shapes).in_keys
    return {
        "_target_": "navrl.networks.make_actor",
        **network,
        "shapes": {key: list(shapes[key]) for key in needed},
        "action_size": instantiate(cfg.robot).command_size,
    }


def make_agent(
    cfg: DictConfig, shapes: Mapping[str, list[int]]
) -> tuple[TensorDictModule, TensorDictModule]:
    """Build actor and critic for observations of the given shapes on ``cfg.device``.

    The weights are seeded and equal on all devices.
    """
    torch.manual_seed(cfg.seed)
    node = actor_node(cfg, shapes)
    own = _plain(cfg.network, "critic") if cfg.network.get("critic") else {}
    critic = {**node, **own, "_target_": "navrl.networks.make_critic"}
    critic.pop("saturation_penalty", None)  # only the actor has a tanh
    torch.manual_seed(cfg.seed)
    networks = instantiate(node), instantiate(critic)
    device = make_device(cfg)
    return tuple(network.to(device) for network in networks)


def make_collector(cfg: DictConfig, actor: TensorDictModule) -> Collector:
    """Build the collector; :meth:`Collector.start` starts worker processes.

    Workers simulate and act on the CPU, for every device of the learner.
    """
    exploration = instantiate(cfg.exploration)
    check_protocol("exploration", exploration, Exploration)
    behavior = instantiate(cfg.behavior, actor=actor, exploration=exploration)
    kind = get_class(cfg.collector._target_)
    has_workers = issubclass(kind, WorkersCollector)
    make_worlds = partial(make_training_env, on_cpu(cfg) if has_workers else cfg)
    policy = {taken_argument(kind, "behavior"): behavior}
    return instantiate(cfg.collector, make_env=make_worlds, **policy, seed=cfg.seed)


def make_trainer(cfg: DictConfig, folder: Path) -> Trainer:
    """Build the trainer of ``navrl-train``.

    Args:
        cfg: A composed ``conf/train.yaml``.
        folder: Run folder; ``<folder>/policy`` receives the best policy so far, and
            ``<folder>/policy_last`` that of the last validation.

    Returns:
        Trainer that can run, or resume from the folder's checkpoint.
    """
    make_device(cfg)
    loggers = make_loggers(cfg)  # report a missing package before anything is built
    shield_resource_tracker()
    instantiate(deployed(cfg).transforms)  # report errors now instead of at the first save
    probe = make_training_env(on_cpu(cfg), cfg.seed, num_worlds=1)
    shapes = observation_shapes(probe)
    probe.close()
    actor, critic = make_agent(cfg, shapes)
    if cfg.get("warm_start") and not is_resumed(folder):
        start_actor(cfg, actor)
    save = partial(save_policy, cfg, actor, shapes)
    algorithm = instantiate(cfg.algorithm, actor=actor, critic=critic)
    check_protocol("algorithm", algorithm, Algorithm)
    if cfg.get("warm_start") and not is_resumed(folder):
        start_critic(cfg, algorithm)
    return Trainer(
        collector=make_collector(cfg, actor),
        sigma=instantiate(cfg.exploration).sigma,
        algorithm=algorithm,
        replay=instantiate(cfg.replay, observation_keys=actor.in_keys),
        curriculum=instantiate(cfg.curriculum),
        evaluate=Validation(cfg, actor),
        on_best=partial(save, folder / "policy"),
        schedule=instantiate(cfg.schedule),
        folder=folder,
        progress_bar=cfg.progress_bar,
        saved_best=partial(saved_metrics, folder / "policy"),
        on_evaluated=partial(save, folder / "policy_last"),
        loggers=loggers,
        hparams=hparams(cfg),
        video=make_video(cfg, actor, partial(_validation_transforms, cfg), folder),
    )


class Validation:
    """Evaluation of the actor on fixed scenarios for any number of pedestrians.

    Args:
        cfg: A composed ``conf/train.yaml``; with ``validation.deployed`` the transforms of the
            deployed policy are used, e.g. its shield.
        actor: Policy in training, evaluated without noise.
    """

    def __init__(self, cfg: DictConfig, actor: TensorDictModule) -> None:
        self._seed, self._count = cfg.validation.seed, cfg.validation.num_episodes
        self._pool = make_pool(cfg, "validation", self._seed, self._count)
        self._actor = actor
        env = make_navigation_env(cfg, self._count, privileged=True)
        self._env = make_env(env, _validation_transforms(cfg))

    def __call__(self, max_dynamic: int) -> dict[str, float]:
        """Play all episodes with 1 to ``max_dynamic`` dynamic pedestrians; return the rates."""
        generator = torch.Generator().manual_seed(self._seed)
        records = evaluate(self._env, self._actor, self._pool.all(generator, max_dynamic))
        return rates(records)


def _validation_transforms(cfg: DictConfig) -> Transform:
    """Return the transforms of the validation: of training, or of the deployed policy."""
    played = deployed(cfg) if cfg.validation.get("deployed", False) else cfg
    return instantiate(played.transforms)


def save_policy(
    cfg: DictConfig,
    actor: TensorDictModule,
    shapes: Mapping[str, list[int]],
    folder: Path,
    metrics: Mapping[str, float],
) -> None:
    """Save the actor as a self-contained bundle."""
    config: dict[str, Any] = {
        part: _plain(deployed(cfg), part) for part in ("transforms", "lidar", "robot")
    }
    config["actor"] = actor_node(cfg, shapes)
    config["time_step_s"] = float(cfg.simulator.time_step_s)
    config["navrl_version"] = navrl.__version__
    card = _card(metrics, recorded_commands(folder.parent))
    save_bundle(folder, config=config, actor=actor, metrics=metrics, card=card)


def deployed(cfg: DictConfig) -> DictConfig:
    """Return the configuration with the robot, lidar and transforms of the deployed policy."""
    copy, parts = cfg.copy(), cfg.get("deployment", {})
    OmegaConf.set_struct(copy, False)  # allow new steps
    copy.transforms.merge_with(parts.get("transforms", {}))
    for part in ("robot", "lidar"):
        if part in parts:  # as a whole: a part of another class has other values
            copy[part] = parts[part]
    return copy


def _plain(cfg: DictConfig, part: str) -> dict[str, Any]:
    return cast(dict[str, Any], OmegaConf.to_container(cfg[part], resolve=True))


def _card(metrics: Mapping[str, float], commands: str) -> str:
    rows = "\n".join(f"| {name} | {value:.6g} |" for name, value in metrics.items())
    return f"""# Policy

Saved by navrl {navrl.__version__} as the best checkpoint of the highest curriculum level.

```
{commands.strip() or "command not recorded"}
```

Validation (chooses the checkpoint; not a test result):

| metric | value |
|---|---|
{rows}
"""
