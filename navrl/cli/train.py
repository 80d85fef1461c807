"""``navrl-train``: train a policy, evaluate the best of it, leave pictures."""

from __future__ import annotations

import logging
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from navrl import build
from navrl.config import hydra_main

log = logging.getLogger(__name__)


@hydra_main("train")
def main(cfg: DictConfig) -> float:
    """Run one training; return the best policy's success rate on the reported suite."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    if cfg.resume is not None:
        folder, cfg = Path(cfg.resume), build.saved_config(cfg.resume)
    else:
        OmegaConf.save(cfg, folder / "config.yaml")
    build.set_threads(cfg.num_threads)
    trainer = build.make_trainer(cfg, folder)
    progress = trainer.run()
    log.info(
        "trained: %d frames, %d updates, %d episodes in %.0f s",
        progress.frames,
        progress.updates,
        progress.episodes,
        progress.seconds,
    )
    summary = build.report(cfg, folder)
    log.info("results are in %s", folder)
    return summary["success_rate"]


if __name__ == "__main__":
    main()
