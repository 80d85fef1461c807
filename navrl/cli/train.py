"""``navrl-train``: train a policy, evaluate its best checkpoint, and draw pictures."""

from __future__ import annotations

import gc
import logging
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import factory, jobs, viz
from navrl.cli.command import hydra_main
from navrl.config import compose, set_default, target_packages

log = logging.getLogger(__name__)


@hydra_main("train")
def main(cfg: DictConfig) -> float:
    """Run one training; return the best policy's success rate on the evaluated suite."""
    if cfg.resume is None:
        folder = Path(HydraConfig.get().runtime.output_dir)
        with jobs.locked(folder):
            jobs.claim_folder(cfg, folder)
            return _train(cfg, folder)
    folder = Path(cfg.resume)
    cfg = jobs.resumed_config(folder, cfg, HydraConfig.get().overrides.task)
    with jobs.locked(folder):
        return _train(cfg, folder)


def _train(cfg: DictConfig, folder: Path) -> float:
    from navrl.training import TrainingStoppedError  # imports torch
    from navrl.training.provenance import record_command

    factory.set_threads(cfg)
    scoring = _scoring(cfg, folder)
    if (folder / "evaluation" / "summary.json").is_file() and factory.bundle_folder(str(folder)):
        log.info("%s: finished before, not trained again", folder)
        summary = jobs.unchanged_evaluation(scoring, folder / "evaluation")
        return _report(cfg, folder) if summary is None else summary["success_rate"]
    record_command(folder)
    jobs.record_config(cfg, folder)
    jobs.check_evaluation(scoring)  # report its errors before hours of training
    trainer = factory.make_trainer(cfg, folder)
    log.info("updates in %s", trainer.algorithm.precision.name)
    gc.collect()
    gc.freeze()  # exclude all current objects from garbage collection
    try:
        progress = trainer.run()
    except TrainingStoppedError as stop:
        print(f"navrl: {stop}", file=sys.stderr)
        sys.exit(128 + stop.signal_number)  # exit status of a signal, as in a shell
    log.info(
        "%d frames, %d updates, %d episodes in %.0f s",
        progress.frames,
        progress.updates,
        progress.episodes,
        progress.seconds,
    )
    return _report(cfg, folder)


def _playing(cfg: DictConfig, folder: Path) -> DictConfig:
    """Return the configuration for playing an episode of the best policy."""
    playing = compose("play")
    set_default(playing, "device", cfg.get("device", "cpu"))
    parts = ("suite", "simulator", "num_threads", "environment", "progress_bar")
    for part in (*parts, *(name for name in ("pedestrians", "timing") if name in cfg)):
        set_default(playing, part, cfg[part])
    set_default(playing, "policy", str(folder))
    # The packages of this run's own configuration are trusted.
    set_default(playing, "allow", sorted(target_packages(cfg) - {"navrl"}))
    return playing


def _scoring(cfg: DictConfig, folder: Path) -> DictConfig:
    """Return the configuration for evaluating the best policy on the suite."""
    scoring = _playing(cfg, folder)
    set_default(scoring, "simulator", cfg.get("final_simulator", cfg.simulator))
    scoring.num_worlds = 100
    return scoring


def _report(cfg: DictConfig, folder: Path) -> float:
    """Evaluate the best policy, and draw learning curves and one episode."""
    viz.plot_curves([folder / "metrics.csv"], folder / "curves.png")
    playing = _playing(cfg, folder)
    recording = jobs.record(playing)
    recording.save(folder / "episode.npz")
    viz.save_gif(recording, folder / "episode.gif", policy=folder.name)
    viz.save_png(recording, folder / "episode.png", policy=folder.name)
    summary = jobs.run_evaluation(_scoring(cfg, folder), folder / "evaluation")
    log.info(
        "best policy on %s, %s: %.1f %% success over %d episodes; all files are in %s",
        summary["suite"],
        summary["simulator"],  # with its pedestrian model, if that is reactive
        100 * summary["success_rate"],
        summary["episodes"],
        folder,
    )
    return summary["success_rate"]


if __name__ == "__main__":
    main()
