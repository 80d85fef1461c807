"""``navrl-compare A B ...``: compare evaluations of the same episodes by paired tests."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

from omegaconf import DictConfig

from navrl import evaluation
from navrl.cli.command import hydra_main

log = logging.getLogger(__name__)


@hydra_main("compare")
def _compare(cfg: DictConfig) -> None:
    """Print the tables and write them to ``cfg.out``."""
    folders = [cfg.folders] if isinstance(cfg.folders, str) else list(cfg.folders)
    table = evaluation.compare_folders(folders, cfg.reference)
    metrics = evaluation.metrics_markdown(table, list(cfg.metrics))
    print(evaluation.markdown(table))
    print(metrics)
    if cfg.out is not None:
        for file in evaluation.write_comparison([table], Path(cfg.out)):
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
