"""Overrides that are out of range or would have no effect, reported before anything is played."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

from omegaconf import DictConfig

from navrl.config import compose, instantiate
from navrl.evaluation.kept import KEPT
from navrl.factory.policy_names import check_policy_name
from navrl.factory.values import flat_values
from navrl.policies.names import bundle_folder

PARTS = ("transforms", "lidar", "robot")
"""What a bundle brings, and what ``change`` changes of a policy."""

_OF_RECORDING = ("recording", "frames_per_s")  # all that counts if a recording is drawn
_NEVER_MEASURED = ("suite", "final_simulator", "deployment", "resume", "validation", "sweep")
_SET_BY_ROWS = (
    *(f"schedule.{name}" for name in ("learning_starts", "total_frames", "checkpoint_every_s")),
    *("schedule.log_every_updates", "schedule.evaluate_every_updates"),
    *("behaviour.random_frames", "replay.capacity"),
)


def check_options(cfg: DictConfig) -> None:
    """Check how an evaluation is played and what is stored of it.

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
        raise ValueError(f"latency={latency}: episodes to be timed, must be >= 0")


def check_start(cfg: DictConfig) -> None:
    """Check options, policy name and overrides of the policy, before torch is imported.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.

    Raises:
        ValueError: See :func:`check_options`, :func:`check_policy_name` and :func:`check_policy`.
    """
    check_options(cfg)
    check_policy_name(cfg.policy)
    check_policy(cfg, is_bundle=bundle_folder(cfg.policy) is not None)


def check_suite(cfg: DictConfig) -> None:
    """Build ``cfg.suite`` and ``cfg.simulator``, and compare an episode with the frozen one.

    Raises:
        ValueError: If a value of theirs is out of range.
    """
    instantiate(cfg.suite).scenarios([0])
    instantiate(cfg.simulator, num_worlds=1).close()


def check_policy(cfg: DictConfig, is_bundle: bool) -> None:
    """Check that every override that concerns the policy has an effect on it.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        is_bundle: Whether the policy brings its own transforms, lidar and robot.

    Raises:
        ValueError: If a part that a bundle brings is overridden beside it, ``change`` names what a
            policy does not have, or a reward is chosen that no recording would have.
    """
    allowed = PARTS if is_bundle else (*PARTS, "controller")
    for part in cfg.change:
        if part not in allowed:
            raise ValueError(
                f"change.{part}: policy={cfg.policy} has none; must be below one of "
                f"{', '.join(f'change.{name}' for name in allowed)}"
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


def check_drawing(cfg: DictConfig) -> None:
    """Check that nothing is overridden that a recording from a file does not depend on.

    Raises:
        ValueError: If something is.
    """
    names = [name for name in cfg if name not in _OF_RECORDING]
    for key, value in _overridden(cfg, names, "play"):
        raise ValueError(
            f"{key}={value}: no effect with recording={cfg.recording}, which is drawn as it is"
        )


def check_measured(overrides: Iterable[str]) -> None:
    """Check that no override of ``navrl-benchmark`` concerns what it never measures.

    Args:
        overrides: Of the command line.

    Raises:
        ValueError: If one does.
    """
    for override in overrides:
        group, _, place = override.lstrip("+~").partition("=")[0].partition("@")
        key = place or group
        if key.partition(".")[0] in _NEVER_MEASURED or key in _SET_BY_ROWS:
            raise ValueError(f"{override}: no effect, navrl-benchmark does not use it")


def _overridden(
    cfg: DictConfig, names: Sequence[str], config_name: str = "evaluate"
) -> list[tuple[str, Any]]:
    """Return values below some keys that are not the defaults."""
    if not names:
        return []
    default, found = _defaults(config_name), flat_values(cfg)
    return [
        (key, found.get(key, "null"))
        for key in {**default, **found}
        if key.partition(".")[0] in names and default.get(key) != found.get(key)
    ]


@lru_cache(maxsize=2)
def _defaults(config_name: str) -> dict[str, Any]:
    return flat_values(compose(config_name))
