"""``navrl-compare A B ...``: evaluations of the same episodes side by side, with paired tests."""

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
    """Print the tables; write them where ``cfg.out`` says."""
    folders = [cfg.folders] if isinstance(cfg.folders, str) else list(cfg.folders)
    table = compare_folders(folders, cfg.reference)
    metrics = metrics_markdown(table, list(cfg.metrics))
    print(markdown(table))
    print(metrics)
    if cfg.out is not None:
        for file in write_comparison([table], Path(cfg.out)):
            log.info("%s", file)


def main() -> None:
    """Take folders as they are, or ``folders=[A, B]`` as any other command of ours."""
    words = sys.argv[1:]
    # Sweeps give folders names such as policy=paper, too.
    folders = [w for w in words if w[:1] != "-" and ("=" not in w or Path(w).is_dir())]
    if folders:
        rest = [word for word in words if word not in folders]
        listed = ",".join(repr(folder) for folder in folders)
        sys.argv[1:] = [f"folders=[{listed}]", *rest]
    _compare()


if __name__ == "__main__":
    main()
