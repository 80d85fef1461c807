"""Checks for overrides that are out of range or without effect, before any episode."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

from omegaconf import DictConfig

from navrl.config import check_types, compose, compose_or_name, did_you_mean, instantiate
from navrl.deprecation import present_key
from navrl.evaluation.kept import KEPT
from navrl.factory.perturbation import check_perturbation
from navrl.factory.policy_names import check_policy_name
from navrl.factory.values import flat_values
from navrl.policies.names import bundle_folder

PARTS = ("transforms", "lidar", "robot")
"""Parts that a bundle includes and ``change`` can modify."""

EFFECTIVE = (
    *("scenario", "simulator", "robot", "lidar", "localization", "pedestrians", "timing"),
    *("reward", "environment", "experiment"),
    *("seed", "pool_size", "empty_share", "num_threads"),
)
"""Keys of ``conf/train.yaml`` that affect a raw environment."""

OF_TRANSFORMED = ("transforms", "network")
"""Keys that affect an environment with the transforms and the inputs of the networks."""

# Keys allowed when a recording is drawn: those with an effect, and the number of threads.
_OF_RECORDING = ("recording", "frames_per_s", "num_threads")
_UNUSED_PARTS = ("suite", "final_simulator", "deployment", "resume", "warm_start")
_UNUSED_PARTS += ("validation", "sweep")
_SET_BY_ROWS = (
    *(f"schedule.{name}" for name in ("learning_starts", "total_frames", "checkpoint_every_s")),
    *("schedule.log_every_updates", "schedule.evaluate_every_updates"),
    *("behavior.random_frames", "replay.capacity"),
)


def check_options(cfg: DictConfig) -> None:
    """Check the options of an evaluation.

    Raises:
        ValueError: If ``num_processes``, ``recordings`` or ``latency`` is out of range.
    """
    processes, kept = cfg.get("num_processes", 1), cfg.get("recordings", "none")
    latency = cfg.get("latency", 0)
    if processes < 1:
        raise ValueError(f"num_processes={processes}: must be >= 1")
    if kept not in KEPT:
        raise ValueError(f"recordings={kept}: must be one of {', '.join(KEPT)}")
    if latency < 0:
        raise ValueError(f"latency={latency}: number of episodes, must be >= 0")


def check_start(cfg: DictConfig) -> None:
    """Check options, policy name and overrides of the policy, before torch is imported.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.

    Raises:
        ValueError: If a check of :func:`check_options`, :func:`check_policy_name`,
            :func:`check_perturbation` or :func:`check_policy` fails.
    """
    check_options(cfg)
    check_policy_name(cfg.policy)
    check_perturbation(cfg)
    check_policy(cfg, is_bundle=bundle_folder(cfg.policy) is not None)


def check_suite(cfg: DictConfig) -> None:
    """Build ``cfg.suite`` and ``cfg.simulator``, and compare an episode with the frozen one.

    Raises:
        ValueError: If one of their values is out of range.
    """
    instantiate(cfg.suite).scenarios([0])
    instantiate(cfg.simulator, num_worlds=1).close()


def check_policy(cfg: DictConfig, is_bundle: bool) -> None:
    """Check that every override of the policy has an effect.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        is_bundle: Whether the policy has its own transforms, lidar and robot.

    Raises:
        ValueError: If a part of a bundle is overridden without ``change``, ``change`` has a part
            that the policy lacks, or a reward is chosen without recordings.
    """
    allowed = PARTS if is_bundle else (*PARTS, "controller")
    for part in cfg.change:
        if part not in allowed:
            raise ValueError(
                f"change.{part}: policy={cfg.policy} has none; must be below one of "
                f"{', '.join(f'change.{name}' for name in allowed)}"
            )
    controller = cfg.get("controller")
    for key, value in ({} if controller is None else flat_values(controller)).items():
        raise ValueError(
            f"controller.{key}={value}: no effect; +change.controller.{present_key(key)}={value} "
            "changes the policy's controller"
        )
    for key, value in _overridden(cfg, PARTS if is_bundle else ()):
        part = key.partition(".")[0]
        raise ValueError(
            f"{key}={value}: no effect, policy={cfg.policy} brings its own {part}; "
            f"+change.{key}={value} changes it"
        )
    if cfg.get("recordings") == "none":
        for key, value in _overridden(cfg, ["reward"]):
            raise ValueError(f"{key}={value}: no effect without recordings=failures or all")


def check_environment(
    overrides: Sequence[str], is_transformed: bool, others: Sequence[str] = ()
) -> None:
    """Check that all overrides of ``conf/train.yaml`` have an effect on an environment.

    Args:
        overrides: Hydra overrides.
        is_transformed: Whether the environment has the transforms of the configuration.
        others: Allowed keys besides :data:`EFFECTIVE` and :data:`OF_TRANSFORMED`.

    Raises:
        ValueError: If one does not exist, has no effect or its value is of another type.
    """
    if isinstance(overrides, str):
        raise ValueError(f"overrides={overrides!r}: must be a list of strings")
    effective = (*EFFECTIVE, *others, *(OF_TRANSFORMED if is_transformed else ()))
    for override in overrides:
        package = override.partition("=")[0].rpartition("@")[2].lstrip("+~")
        key = re.split("[./]", package)[0]
        if key not in effective:
            only = '; it has with observation="transformed"' if key in OF_TRANSFORMED else ""
            raise ValueError(
                f"overrides={override!r}: must be of {', '.join(effective)}; {key} has no effect "
                f"on this environment{only}"
            )
    check_types("train", overrides, compose_or_name("train", overrides))


def check_flow(cfg: DictConfig) -> None:
    """Check that overrides of ``navrl-train-flow`` have an effect on the recorded episodes.

    Args:
        cfg: A composed ``conf/train_flow.yaml``.

    Raises:
        ValueError: If a suite, its data or a reward is chosen.
    """
    for key, value in _overridden(cfg, ("suite", "data", "reward"), "train_flow"):
        raise ValueError(
            f"{key}={value}: no effect, navrl-train-flow plays the episodes of scenario"
        )


def check_drawing(cfg: DictConfig) -> None:
    """Check that all overrides have an effect on the drawing of a recording.

    Raises:
        ValueError: If an override has no effect.
    """
    names = [str(name) for name in cfg if name not in _OF_RECORDING]
    for key, value in _overridden(cfg, names, "play"):
        raise ValueError(
            f"{key}={value}: no effect with recording={cfg.recording}, which is drawn as it is"
        )


def check_keys(cfg: DictConfig, config_name: str) -> None:
    """Check that the command knows each outermost key, one that was added with ``+`` too.

    Args:
        cfg: A composed configuration.
        config_name: Primary config, e.g. ``doctor``.

    Raises:
        ValueError: If a key is unknown; the message has the nearest ones.
    """
    known = [str(key) for key in compose(config_name)]
    for key in map(str, cfg):
        if key not in known:
            near = did_you_mean(key, known)
            raise ValueError(
                f"{key}={cfg[key]}: no effect, navrl-{config_name} has no such key{near}"
            )


def check_measured(overrides: Iterable[str]) -> None:
    """Check that all overrides of ``navrl-benchmark`` have an effect.

    Args:
        overrides: Overrides of the command line.

    Raises:
        ValueError: If one has no effect.
    """
    for override in overrides:
        group, _, place = override.lstrip("+~").partition("=")[0].partition("@")
        key = place or group
        if key.partition(".")[0] in _UNUSED_PARTS or key in _SET_BY_ROWS:
            raise ValueError(f"{override}: no effect, navrl-benchmark does not use it")


def _overridden(
    cfg: DictConfig, names: Sequence[str], config_name: str = "evaluate"
) -> list[tuple[str, Any]]:
    """Return values below some keys that differ from the defaults."""
    if not names:
        return []
    default, found = _defaults(config_name), flat_values(cfg)
    return [
        (key, found.get(key, "null"))
        for key in {**default, **found}
        if key.partition(".")[0] in names and default.get(key) != found.get(key)
    ]


@lru_cache(maxsize=3)
def _defaults(config_name: str) -> dict[str, Any]:
    return flat_values(compose(config_name))
