"""``navrl-export``: write one ONNX file that maps a scan to a command."""

from __future__ import annotations

import logging
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import factory
from navrl.cli.command import hydra_main, missing_extras
from navrl.factory.overrides import check_start

log = logging.getLogger(__name__)


@hydra_main("export")
def main(cfg: DictConfig) -> None:
    """Export ``cfg.policy``."""
    check_start(cfg)
    factory.set_threads(cfg)
    from navrl.jobs.exporting import export  # imports torch

    folder = Path(HydraConfig.get().runtime.output_dir)
    file = folder / f"{Path(cfg.policy).name}.onnx" if cfg.output is None else Path(cfg.output)
    with missing_extras():
        error = export(cfg, file)
    size = file.stat().st_size / 1e6
    log.info("%s: %.1f MB, within %.1e of the runner", file, size, error)


if __name__ == "__main__":
    main()
