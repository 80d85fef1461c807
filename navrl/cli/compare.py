"""``navrl-compare A B ...``: compare evaluations of the same episodes by paired tests."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

from omegaconf import DictConfig

from navrl.config import hydra_main
from navrl.evaluation import compare_folders, markdown, metrics_markdown, write_comparison

log = logging.getLogger(__name__)


@hydra_main("compare")
def _compare(cfg: DictConfig) -> None:
    """Print the tables and write them to ``cfg.out``."""
    folders = [cfg.folders] if isinstance(cfg.folders, str) else list(cfg.folders)
    table = compare_folders(folders, cfg.reference)
    metrics = metrics_markdown(table, list(cfg.metrics))
    print(markdown(table))
    print(metrics)
    if cfg.out is not None:
        for file in write_comparison([table], Path(cfg.out)):
            log.info("%s", file)


def main() -> None:
    """Accept folders as arguments, or as ``folders=[A, B]``."""
    words = sys.argv[1:]
    # Folders of sweeps may have names such as policy=paper.
    folders = [w for w in words if w[:1] != "-" and ("=" not in w or Path(w).is_dir())]
    if folders:
        rest = [word for word in words if word not in folders]
        listed = ",".join(repr(folder) for folder in folders)
        sys.argv[1:] = [f"folders=[{listed}]", *rest]
    _compare()


if __name__ == "__main__":
    main()
