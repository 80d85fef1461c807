"""``navrl-play``: play one episode and save it as GIF, PNG and data."""

from __future__ import annotations

import logging
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import factory, jobs, viz
from navrl.cli.command import hydra_main
from navrl.factory.overrides import check_drawing, check_start

log = logging.getLogger(__name__)


@hydra_main("play")
def main(cfg: DictConfig) -> None:
    """Record an episode and draw it."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    if cfg.recording is not None:
        check_drawing(cfg)
        from navrl.evaluation.recording import Recording  # imports torch
        from navrl.viz.origins import policy_of

        recording, policy = Recording.load(cfg.recording), policy_of(Path(cfg.recording))
    else:
        check_start(cfg)
        factory.set_threads(cfg)
        recording, policy = jobs.record(cfg), factory.policy_name(cfg)
        recording.save(folder / "episode.npz")
    viz.save_gif(recording, folder / "episode.gif", cfg.frames_per_s, policy)
    viz.save_png(recording, folder / "episode.png", policy=policy)
    log.info("%s after %d steps; %s", recording.outcome, recording.num_steps, folder)


if __name__ == "__main__":
    main()
