"""Start of the commands that read the log of a robot."""

from __future__ import annotations

from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl.factory.policy_names import check_policy_name


def checked_folder(cfg: DictConfig) -> Path:
    """Return the run folder after a check of policy and log, which does not import torch.

    Raises:
        ValueError: If the policy or the log does not exist.
    """
    check_policy_name(cfg.policy)
    if not Path(cfg.bag).exists():
        raise ValueError(f"bag={cfg.bag}: no such file or folder")
    return Path(HydraConfig.get().runtime.output_dir)
