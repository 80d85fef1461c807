"""``navrl-train``: train a policy, evaluate the best of it, leave pictures."""

from __future__ import annotations

import gc
import logging
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from navrl import build
from navrl.build.provenance import record_command
from navrl.config import compose, hydra_main, set_default, target_packages
from navrl.evaluation.stored import Evaluation
from navrl.viz import plot_curves, save_gif, save_png

log = logging.getLogger(__name__)


@hydra_main("train")
def main(cfg: DictConfig) -> float:
    """Run one training; return the best policy's success rate on the reported suite."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    if cfg.resume is None:
        build.claim_folder(cfg, folder)
    else:
        folder = Path(cfg.resume)
        cfg = _resumed(folder, cfg)
    summary = folder / "evaluation" / "summary.json"
    if summary.is_file():
        log.info("%s: finished before, not trained again", folder)
        return Evaluation.load(summary.parent).summary["success_rate"]
    record_command(folder)
    build.set_threads(cfg)
    trainer = build.make_trainer(cfg, folder)
    log.info("updates in %s", trainer.algorithm.precision.name)
    gc.collect()
    gc.freeze()  # all that is there by now stays: no need to look for garbage in it, over and over
    progress = trainer.run()
    log.info(
        "%d frames, %d updates, %d episodes in %.0f s",
        progress.frames,
        progress.updates,
        progress.episodes,
        progress.seconds,
    )
    return _report(cfg, folder)


def _resumed(folder: Path, cfg: DictConfig) -> DictConfig:
    """Return the configuration of the run in ``folder``, on another device if one is given."""
    file = folder / "config.yaml"
    if not file.is_file():
        raise ValueError(f"resume={folder}: no run there, {file} is missing")
    run = OmegaConf.load(file)
    if any(override.startswith("device=") for override in HydraConfig.get().overrides.task):
        if "device" not in run:
            raise ValueError(f"device={cfg.device}: the run in {folder} is older than this key")
        run.device = cfg.device
    return run


def _report(cfg: DictConfig, folder: Path) -> float:
    """Evaluate the best policy, then draw its curves and one of its episodes."""
    plot_curves([folder / "metrics.csv"], folder / "curves.png")
    playing = compose("play")
    set_default(playing, "device", cfg.get("device", "cpu"))
    for part in ("suite", "simulator", "num_threads", "environment", "progress_bar"):
        set_default(playing, part, cfg[part])
    set_default(playing, "policy", str(folder))
    # What this very run was made of may be built again.
    set_default(playing, "allow", sorted(target_packages(cfg) - {"navrl"}))
    recording = build.record(playing)
    recording.save(folder / "episode.npz")
    save_gif(recording, folder / "episode.gif")
    save_png(recording, folder / "episode.png")
    set_default(playing, "simulator", cfg.get("final_simulator", cfg.simulator))
    playing.num_worlds = 100
    summary = build.run_evaluation(playing, folder / "evaluation")
    log.info(
        "best policy on %s: %.1f %% success over %d episodes; everything is in %s",
        summary["suite"],
        100 * summary["success_rate"],
        summary["episodes"],
        folder,
    )
    return summary["success_rate"]


if __name__ == "__main__":
    main()
