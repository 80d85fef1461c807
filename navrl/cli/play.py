"""``navrl-play``: play one episode and save it as GIF, PNG and data."""

from __future__ import annotations

import logging
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import factory, jobs
from navrl.config import hydra_main
from navrl.evaluation.recording import Recording
from navrl.factory.overrides import check_drawing
from navrl.viz import save_gif, save_png

log = logging.getLogger(__name__)


@hydra_main("play")
def main(cfg: DictConfig) -> None:
    """Record an episode and draw it."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    if cfg.recording is not None:
        check_drawing(cfg)
        recording = Recording.load(cfg.recording)
    else:
        factory.set_threads(cfg)
        recording = jobs.record(cfg)
        recording.save(folder / "episode.npz")
    save_gif(recording, folder / "episode.gif", cfg.frames_per_s)
    save_png(recording, folder / "episode.png")
    log.info("%s after %d steps; %s", recording.outcome, recording.num_steps, folder)


if __name__ == "__main__":
    main()
