"""Composition root: from a resolved config to worlds, environment, agent and trainer."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numba
import torch
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModule
from torchrl.envs import ActionScaling, Transform, TransformedEnv

from navrl.config import compose, instantiate
from navrl.envs import NavigationEnv, Outcome
from navrl.envs.gymnasium import GymnasiumNavigation
from navrl.evaluation import evaluate
from navrl.training import Trainer
from navrl.worlds import ScenarioPool, Suite


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


def make_navigation_env(
    cfg: DictConfig,
    num_worlds: int,
    scenarios: ScenarioPool | None = None,
    seed: int = 0,
    privileged: bool = False,
) -> NavigationEnv:
    """Build the simulator and the raw environment.

    Args:
        cfg: Config with ``simulator``, ``robot``, ``lidar``, ``reward`` and ``environment``.
        num_worlds: Batch size.
        scenarios: Where episodes are drawn from; ``None`` if they are set from outside.
        seed: Seed of the environment's generator.
        privileged: Whether the true state is observed too.

    Returns:
        An environment with physical actions and raw outputs.
    """
    return NavigationEnv(
        instantiate(cfg.simulator, num_worlds=num_worlds),
        scenarios,
        rewards={name: instantiate(term) for name, term in cfg.reward.items() if term is not None},
        privileged=privileged,
        seed=seed,
        **cfg.environment,
    )


def make_pool(cfg: DictConfig, name: str = "train", seed: int | None = None, size: int | None = None) -> ScenarioPool:
    """Return the scenarios that episodes are drawn from, generated once and cached.

    Args:
        cfg: Config with ``scenario``, ``seed``, ``pool_size`` and ``num_threads``.
        name: Of the suite they belong to.
        seed: Of the suite; ``cfg.seed`` if ``None``.
        size: Number of scenarios; ``cfg.pool_size`` if ``None``.
    """
    suite = Suite(
        name,
        cfg.seed if seed is None else seed,
        cfg.pool_size if size is None else size,
        instantiate(cfg.scenario),
    )
    key = hashlib.sha256(
        f"{name} {suite.seed} {suite.num_episodes} {OmegaConf.to_yaml(cfg.scenario)}".encode()
    ).hexdigest()[:16]
    return ScenarioPool(suite, cfg.num_threads, _cache_folder() / "pools" / f"{key}.npz")


def _cache_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "navrl"


def make_env(env: NavigationEnv, transforms: Transform) -> TransformedEnv:
    """Append the perception transforms, then normalise actions to [-1, 1]."""
    transformed = TransformedEnv(env, transforms)
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


def make_gymnasium_env(overrides: Sequence[str] = (), **kwargs: object) -> GymnasiumNavigation:
    """Build the environment behind ``gymnasium.make("navrl/Navigation-v0")``.

    Args:
        overrides: Hydra overrides of ``conf/train.yaml``, e.g. ``["scenario=corridor",
            "simulator=bullet"]``.
        kwargs: None are taken; gymnasium's own are named here so that a typo gives an error.

    Returns:
        One world with the paper's raw observations.

    Raises:
        ValueError: If a keyword is unknown.
    """
    if kwargs:
        raise ValueError(f"unknown keyword {sorted(kwargs)}: only 'overrides' is allowed")
    cfg = compose("train", list(overrides))
    return GymnasiumNavigation(make_navigation_env(cfg, 1, make_pool(cfg), cfg.seed))


def make_trainer(cfg: DictConfig, folder: Path) -> Trainer:
    """Wire everything that ``navrl-train`` runs.

    Args:
        cfg: A composed ``conf/train.yaml``.
        folder: Run folder; ``<folder>/policy`` receives the best policy so far.

    Returns:
        A trainer, ready to run or to resume from the folder's checkpoint.
    """
    transforms = instantiate(cfg.transforms)
    env = make_env(
        make_navigation_env(cfg, cfg.num_worlds, make_pool(cfg), seed=cfg.seed), transforms
    )
    shapes = observation_shapes(env)
    actor, critic = make_agent(cfg, shapes)
    return Trainer(
        env=env,
        behaviour=instantiate(
            cfg.behaviour, actor=actor, exploration=instantiate(cfg.exploration)
        ),
        algorithm=instantiate(cfg.algorithm, actor=actor, critic=critic),
        replay=instantiate(cfg.replay, observation_keys=actor.in_keys),
        curriculum=instantiate(cfg.curriculum),
        evaluate=Validation(cfg, actor),
        on_best=lambda metrics: save_policy(cfg, actor, shapes, folder / "policy", metrics),
        schedule=instantiate(cfg.schedule),
        folder=folder,
        progress_bar=cfg.progress_bar,
    )


class Validation:
    """Success of the actor on fixed scenarios, at any number of pedestrians.

    Args:
        cfg: A composed ``conf/train.yaml``.
        actor: The policy in training, evaluated without noise.
    """

    def __init__(self, cfg: DictConfig, actor: TensorDictModule) -> None:
        self._seed, self._count = cfg.validation.seed, cfg.validation.num_episodes
        self._pool = make_pool(cfg, "validation", self._seed, self._count)
        self._actor = actor
        self._env = make_env(
            make_navigation_env(cfg, self._count, privileged=True), instantiate(cfg.transforms)
        )

    def __call__(self, max_dynamic: int) -> dict[str, float]:
        """Play all episodes with 1 to ``max_dynamic`` dynamic pedestrians; return the rates."""
        generator = torch.Generator().manual_seed(self._seed)
        records = evaluate(self._env, self._actor, self._pool.all(generator, max_dynamic))
        counts = Counter(record.outcome for record in records)
        return {f"{name}_rate": counts[name] / len(records) for name in OUTCOMES}


OUTCOMES = [o.name.lower() for o in Outcome if o is not Outcome.RUNNING]

def save_policy(cfg, actor, shapes, folder, metrics):
    import json
    from safetensors.torch import save_file
    folder.mkdir(exist_ok=True, parents=True)
    save_file({k: v.contiguous().clone() for k, v in actor.state_dict().items()}, folder / "weights.safetensors")
    (folder / "metrics.json").write_text(json.dumps(metrics))
