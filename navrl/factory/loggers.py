"""Construction of a run's loggers, and of the videos sent to them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModule

from navrl.config import instantiate
from navrl.evaluation.recorder import record_episode
from navrl.factory.environment import make_env, make_navigation_env
from navrl.factory.values import flat_values
from navrl.training.loggers import RunLogger
from navrl.viz import save_gif
from navrl.worlds import Suite


def make_loggers(cfg: DictConfig) -> dict[str, RunLogger] | None:
    """Build the loggers of ``cfg.logger``; ``None`` for an older config without the group.

    Raises:
        ValueError: If the group has a value that is not a logger.
        InstantiationException: If a package is missing, or an argument is wrong.
    """
    if "logger" not in cfg:
        return None
    loggers = {}
    for name, node in (cfg.logger or {}).items():
        if node is None:
            continue
        loggers[str(name)] = logger = instantiate(node)
        if not callable(getattr(logger, "open", None)):
            raise ValueError(f"logger.{name}={node}: must have a _target_ with a method open")
    return loggers


def hparams(cfg: DictConfig) -> dict[str, Any]:
    """Return all values of a configuration by dotted name, resolved, for the loggers."""
    return flat_values(OmegaConf.create(OmegaConf.to_container(cfg, resolve=True)))


class EpisodeVideo:
    """Video of the first validation episode, with all its pedestrians, at regular validations.

    Args:
        cfg: A composed ``conf/train.yaml`` with ``video_every_validations``.
        actor: Policy in training, played without noise.
        transforms: Builds the transforms of the validation.
        folder: Run folder; videos are written to ``<folder>/videos``.
    """

    def __init__(
        self,
        cfg: DictConfig,
        actor: TensorDictModule,
        transforms: Callable[[], Any],
        folder: Path,
    ) -> None:
        """Generate the episode and build its environment."""
        seed, count = cfg.validation.seed, cfg.validation.num_episodes
        suite = Suite("validation", seed, count, instantiate(cfg.scenario))
        (self._scenario,) = suite.scenarios([0])
        self._env = make_env(make_navigation_env(cfg, 1, privileged=True), transforms())
        self._actor, self._folder = actor, folder / "videos"
        self._every, self._validations = cfg.video_every_validations, 0

    def __call__(self, frames: int) -> Path | None:
        """Play and draw the episode after a validation.

        Args:
            frames: Frame count of the training.

        Returns:
            The written ``.gif``, ``None`` if this validation has no video.
        """
        self._validations += 1
        if (self._validations - 1) % self._every:
            return None
        recording = record_episode(self._env, self._actor, self._scenario)
        file = self._folder / f"episode_{frames:09d}.gif"
        return save_gif(recording, file, policy=f"{file.parents[1].name}, {frames:,} frames")


def make_video(
    cfg: DictConfig, actor: TensorDictModule, transforms: Callable[[], Any], folder: Path
) -> EpisodeVideo | None:
    """Build the video of ``cfg.video_every_validations``; ``None`` if that is 0.

    Raises:
        ValueError: If it is negative or not an integer.
    """
    every = cfg.get("video_every_validations", 0)
    if not isinstance(every, int) or every < 0:
        raise ValueError(f"video_every_validations={every}: must be an integer of at least 0")
    return EpisodeVideo(cfg, actor, transforms, folder) if every else None
