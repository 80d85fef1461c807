"""Construction of worlds and environments from a configuration."""

from __future__ import annotations

import functools
import hashlib
import logging
import os
from collections.abc import Sequence
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor
from torchrl.data import Composite
from torchrl.data.tensor_specs import ContinuousBox
from torchrl.envs import ActionScaling, Transform, TransformedEnv

from navrl.checks import check_counts, check_positive
from navrl.config import compose, did_you_mean, instantiate, options
from navrl.envs import NavigationEnv, TransformedNavigationEnv
from navrl.factory.overrides import check_environment
from navrl.ops.backend import find_device
from navrl.transforms.min_pool import check_lidar
from navrl.worlds import ScenarioPool, Suite

LOG = logging.getLogger(__name__)


def num_threads(cfg: DictConfig) -> int:
    """Return ``cfg.num_threads``, or :func:`free_cores` if it is null.

    Raises:
        ValueError: If it is not between 1 and the number of cores.
    """
    cores = os.cpu_count() or 1
    count = free_cores() if cfg.num_threads is None else cfg.num_threads
    if not 1 <= count <= cores:
        raise ValueError(f"num_threads={count}: must be between 1 and {cores} on this machine")
    return count


@functools.cache
def free_cores() -> int:
    """Return the number of cores that other programs leave idle, at least 1.

    Threads that wait for each other stall if they outnumber the idle cores: on a machine with two
    busy cores an evaluation with two threads took more than 15 minutes, with one 48 s. Cores that
    are excluded by the affinity of the process and the load of the last minute are subtracted, and
    ``OMP_NUM_THREADS`` is an upper limit. The first answer is final: later, the load includes this
    process.
    """
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    usable = usable or 1
    limit = os.environ.get("OMP_NUM_THREADS", "")
    usable = min(usable, int(limit)) if limit.isdecimal() and int(limit) else usable
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return max(1, min(usable, round((os.cpu_count() or 1) - load)))


def set_threads(cfg: DictConfig) -> None:
    """Set the number of threads of torch, which the compiled kernels use too.

    TorchRL's log is sent to the log of the command, without color codes, and warnings only.

    Raises:
        ValueError: If ``num_threads`` is out of range, see :func:`num_threads`.
    """
    count = num_threads(cfg)
    torch.set_num_threads(count)
    torch.set_flush_denormal(True)  # denormal gradients slow products tenfold
    if cfg.num_threads is None and count < (os.cpu_count() or 1):
        LOG.info("%d of %d threads; num_threads=N sets another number", count, os.cpu_count())
    _redirect_torchrl_log()


def _redirect_torchrl_log() -> None:
    """Let TorchRL's log propagate; its own handler colors every line, in files too."""
    log = logging.getLogger("torchrl")
    for handler in list(log.handlers):
        log.removeHandler(handler)
    log.propagate = True
    if "RL_LOGGING_LEVEL" not in os.environ:
        log.setLevel(logging.WARNING)


def make_device(cfg: DictConfig) -> torch.device:
    """Return the device of ``cfg.device``; the CPU for older configs without the key.

    Raises:
        ValueError: If it is neither ``cpu`` nor ``cuda``, or not available.
    """
    return find_device(cfg.get("device", "cpu"))


def on_cpu(cfg: DictConfig) -> DictConfig:
    """Return a copy of the configuration with all devices set to the CPU."""
    copy = cfg.copy()
    OmegaConf.set_struct(copy, False)
    copy.device = "cpu"
    return copy


def make_navigation_env(
    cfg: DictConfig,
    num_worlds: int,
    scenarios: ScenarioPool | None = None,
    seed: int | None = 0,
    privileged: bool = False,
) -> NavigationEnv:
    """Build the simulator and the raw environment.

    Args:
        cfg: Config with ``simulator``, ``robot``, ``lidar``, ``reward`` and ``environment``, and
            optionally ``localization``.
        num_worlds: Batch size.
        scenarios: Source of the episodes; ``None`` if they are set by the caller.
        seed: Seed of the environment's generator; ``None`` draws one.
        privileged: Whether the observation includes the true state.

    Returns:
        An environment with physical actions and raw outputs.

    Raises:
        ValueError: If ``simulator.num_worlds`` is not ``num_worlds``, or the device is wrong.
    """
    worlds = cfg.simulator.get("num_worlds", cfg.num_worlds)
    if worlds != cfg.num_worlds:
        raise ValueError(f"simulator.num_worlds={worlds}: no effect, num_worlds={worlds} sets it")
    make_device(cfg)  # validate the device before building anything
    return NavigationEnv(
        instantiate(cfg.simulator, num_worlds=num_worlds),
        scenarios,
        rewards={name: instantiate(term) for name, term in cfg.get("reward", {}).items()},
        privileged=privileged,
        seed=seed,
        localization=instantiate(cfg.get("localization")),
        **cfg.environment,
    )


def make_pool(
    cfg: DictConfig, name: str = "train", seed: int | None = None, size: int | None = None
) -> ScenarioPool:
    """Return the pool of training scenarios, generated once and cached.

    Args:
        cfg: Config with ``scenario``, ``seed``, ``pool_size``, ``empty_share`` and ``num_threads``.
        name: Name of their suite.
        seed: Seed of the suite; ``cfg.seed`` if ``None``.
        size: Number of scenarios; ``cfg.pool_size`` if ``None``.

    Raises:
        ValueError: If there would be no scenario.
    """
    if size is None:
        check_counts(pool_size=cfg.pool_size)
    suite = Suite(
        name,
        cfg.seed if seed is None else seed,
        cfg.pool_size if size is None else size,
        instantiate(cfg.scenario),
    )
    key = hashlib.sha256(
        f"{name} {suite.seed} {suite.num_episodes} {OmegaConf.to_yaml(cfg.scenario)}".encode()
    ).hexdigest()[:16]
    cache = _cache_folder() / "pools" / f"{key}.npz"
    shown = cfg.get("progress_bar", False)
    return ScenarioPool(suite, num_threads(cfg), cache, cfg.empty_share, progress=shown)


def _cache_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "navrl"


def make_env(
    env: NavigationEnv, transforms: Transform, is_normalized: bool = True
) -> TransformedEnv:
    """Append a clone of the perception transforms, then normalize actions to [-1, 1].

    Args:
        env: Raw environment.
        transforms: Transforms, which are cloned.
        is_normalized: False leaves the actions as the transforms take them.

    Raises:
        ValueError: If the transforms have another mount or other angles of the lidar.
    """
    check_lidar(transforms, env.simulator.lidar)
    transformed = TransformedNavigationEnv(env, transforms.clone())
    if is_normalized:
        transformed.append_transform(ActionScaling())
    for part in (env, transformed):
        _share_bounds(part.full_observation_spec)
        _share_bounds(part.full_state_spec)
    return transformed


def _share_bounds(specs: Composite) -> None:
    """Share the bounds of one world among all worlds; saves 180 MB for 4,096 worlds."""
    for key in specs.keys(True, True):
        space = specs[key].space
        if isinstance(space, ContinuousBox) and not space.batch_size:  # not shared yet
            space._low, space._high = (_shared(bound) for bound in (space.low, space.high))


def _shared(bound: Tensor) -> Tensor:
    first = bound.flatten()[:1]
    return first.clone().expand(bound.shape) if bool((bound == first).all()) else bound


def make_training_env(
    cfg: DictConfig, seed: int | None, num_worlds: int | None = None
) -> TransformedEnv:
    """Build a training environment; workers call this in their own process.

    Args:
        cfg: A composed ``conf/train.yaml``.
        seed: Seed of the environment, ``None`` draws one; the pool of scenarios depends on
            ``cfg.seed``.
        num_worlds: Batch size; ``cfg.num_worlds`` if ``None``.
    """
    count = cfg.num_worlds if num_worlds is None else num_worlds
    env = make_navigation_env(cfg, count, make_pool(cfg), seed)
    return make_env(env, instantiate(cfg.transforms))


def make_batched_env(
    name_or_overrides: str | Sequence[str] = "quick", num_worlds: int = 64, seed: int | None = 0
) -> TransformedEnv:
    """Build the environment behind :func:`navrl.make`; see there for arguments and errors."""
    is_name = isinstance(name_or_overrides, str)
    overrides = [f"experiment={name_or_overrides}"] if is_name else list(name_or_overrides)
    if is_name and name_or_overrides not in options("experiment"):
        near = did_you_mean(name_or_overrides, options("experiment"))
        raise ValueError(
            f"name_or_overrides={name_or_overrides!r}: must be a list of overrides or one of "
            f"{', '.join(options('experiment'))}{near}"
        )
    check_positive(num_worlds=num_worlds)
    check_environment(overrides, is_transformed=True, others=("device", "hardware"))
    cfg = compose("train", overrides)
    cfg.num_worlds = num_worlds
    return make_training_env(cfg, seed)
