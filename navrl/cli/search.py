"""``navrl-search``: search hyper-parameters of ``navrl-train``."""

from __future__ import annotations

import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import factory, jobs
from navrl.cli.command import hydra_main, missing_extras


@hydra_main("search")
def main(cfg: DictConfig) -> None:
    """Run trials until the study has ``cfg.trials``."""
    from navrl.jobs.searching import search  # imports torch
    from navrl.training import TrainingStoppedError

    folder = Path(HydraConfig.get().runtime.output_dir)
    claimed = cfg.copy()
    claimed.trials = None  # a study may be continued with more trials
    factory.set_threads(cfg)
    with jobs.locked(folder):
        jobs.claim_folder(claimed, folder)
        try:
            with missing_extras():
                search(cfg, list(HydraConfig.get().overrides.task), folder)
        except TrainingStoppedError as stop:
            print(f"navrl: {stop}; the same command resumes the search", file=sys.stderr)
            sys.exit(128 + stop.signal_number)


if __name__ == "__main__":
    main()
