"""``navrl-export``: write one ONNX file that maps a scan to a command, or a changed bundle."""

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
    folder = Path(HydraConfig.get().runtime.output_dir)
    name = Path(cfg.policy).name
    if cfg.format == "bundle":
        _export_bundle(cfg, folder / name if cfg.output is None else Path(cfg.output))
    elif cfg.format == "onnx":
        _export_onnx(cfg, folder / f"{name}.onnx" if cfg.output is None else Path(cfg.output))
    else:
        raise ValueError(f"format={cfg.format}: must be onnx or bundle")


def _export_bundle(cfg: DictConfig, folder: Path) -> None:
    from navrl.jobs.changed_bundle import export_bundle  # imports torch

    if cfg.network_only:
        raise ValueError("network_only=true: must be false for format=bundle")
    export_bundle(cfg, folder)
    log.info("%s: policy=%s has these settings; it has no scores yet", folder, folder)


def _export_onnx(cfg: DictConfig, file: Path) -> None:
    from navrl.jobs.exporting import export  # imports torch

    with missing_extras():
        error = export(cfg, file)
    size = file.stat().st_size / 1e6
    log.info("%s: %.1f MB, within %.1e of the runner", file, size, error)


if __name__ == "__main__":
    main()
