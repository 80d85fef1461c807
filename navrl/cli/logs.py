"""Start of the commands that read the log of a robot."""

from __future__ import annotations

from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl.factory.overrides import check_keys
from navrl.factory.policy_names import check_policy_name


def checked_folder(cfg: DictConfig, live: tuple[str, ...] = ()) -> Path:
    """Return the run folder after a check of policy and log, which does not import torch.

    Args:
        cfg: Configuration of the command.
        live: Names of live topics that ``cfg.bag`` may have in place of a log.

    Raises:
        ValueError: If a key has no effect, or if the policy or the log does not exist.
    """
    check_keys(cfg, HydraConfig.get().job.config_name or "")
    check_policy_name(cfg.policy)
    if cfg.bag not in live and not Path(cfg.bag).exists():
        also = f", nor one of {', '.join(live)} for live topics" if live else ""
        raise ValueError(f"bag={cfg.bag}: no such file or folder{also}")
    return Path(HydraConfig.get().runtime.output_dir)
