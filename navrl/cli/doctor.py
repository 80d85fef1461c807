"""``navrl-doctor``: say what a policy would see of a bag, a log or live topics."""

from __future__ import annotations

import sys

from omegaconf import DictConfig

from navrl.cli.command import hydra_main, missing_extras
from navrl.cli.logs import checked_folder


@hydra_main("doctor", argument="bag")
def main(cfg: DictConfig) -> None:
    """Print the findings of ``cfg.bag`` and a verdict; exit with 3 if it will not work."""
    folder = checked_folder(cfg, live=("ros1", "ros2"))
    from navrl.jobs.diagnosing import outcome, run_doctor, shown  # imports torch

    with missing_extras():
        level, findings = run_doctor(cfg, folder)
    ended = outcome(level, cfg.strict)
    print("\n".join(shown(findings)))
    print(f"{cfg.bag}: {ended['verdict']}; details in {folder}")
    if ended["status"]:
        sys.exit(ended["status"])


if __name__ == "__main__":
    main()
