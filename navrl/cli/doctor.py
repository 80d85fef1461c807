"""``navrl-doctor``: say what a policy would see of a bag or log."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl.cli.command import hydra_main
from navrl.factory.policy_names import check_policy_name

log = logging.getLogger(__name__)


@hydra_main("doctor", argument="bag")
def main(cfg: DictConfig) -> None:
    """Print the findings of ``cfg.bag`` and a verdict; exit with 3 if it will not work."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    check_policy_name(cfg.policy)
    if not Path(cfg.bag).exists():
        raise ValueError(f"bag={cfg.bag}: no such file or folder")
    from navrl.jobs.diagnosing import outcome, run_doctor, shown  # imports torch

    try:
        level, findings = run_doctor(cfg, folder)
    except ImportError as missing:  # a missing extra, named in the message
        raise ValueError(str(missing)) from missing
    ended = outcome(level, cfg.strict)
    print("\n".join(shown(findings)))
    print(f"{cfg.bag}: {ended['verdict']}; details in {folder}")
    if ended["status"]:
        sys.exit(ended["status"])


if __name__ == "__main__":
    main()
