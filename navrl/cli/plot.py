"""``navrl-plot``: draw a picture from the files of runs, evaluations and episodes."""

from __future__ import annotations

import logging
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, ListConfig

from navrl.cli.command import hydra_main, missing_extras
from navrl.config import instantiate

log = logging.getLogger(__name__)


@hydra_main("plot")
def main(cfg: DictConfig) -> None:
    """Draw ``cfg.picture`` from ``cfg.source``."""
    sources = list(cfg.source) if isinstance(cfg.source, ListConfig) else [str(cfg.source)]
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    out = folder / hydra.runtime.choices.picture if cfg.out is None else Path(cfg.out)
    draw = instantiate(cfg.picture)
    with missing_extras():
        files = draw(sources, out)
    for file in files:
        log.info("%s", file)


if __name__ == "__main__":
    main()
