"""``navrl-train-flow``: train the network of the scan flow."""

from __future__ import annotations

import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import factory, jobs
from navrl.cli.command import hydra_main
from navrl.factory.overrides import check_start


@hydra_main("train_flow")
def main(cfg: DictConfig) -> None:
    """Record episodes, train on them, and print the figures on the held-out ones."""
    check_start(cfg)
    from navrl.jobs.flow import train_flow  # imports torch
    from navrl.training import TrainingStoppedError

    folder = Path(HydraConfig.get().runtime.output_dir)
    factory.set_threads(cfg)
    with jobs.locked(folder):
        jobs.claim_folder(cfg, folder)
        try:
            print(train_flow(cfg, folder))
        except TrainingStoppedError as stop:
            print(f"navrl: {stop}", file=sys.stderr)
            sys.exit(128 + stop.signal_number)


if __name__ == "__main__":
    main()
