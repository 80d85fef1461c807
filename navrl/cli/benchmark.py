"""``navrl-benchmark``: measure speed and memory; writes a table, JSON and pictures."""

from __future__ import annotations

import logging
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import factory, jobs
from navrl.cli.command import hydra_main
from navrl.factory.overrides import check_measured
from navrl.jobs.row_names import check_rows

log = logging.getLogger(__name__)


@hydra_main("benchmark")
def main(cfg: DictConfig) -> None:
    """Measure, print the table and save it."""
    check_measured(HydraConfig.get().overrides.task)
    check_rows(cfg.rows)
    folder = Path(HydraConfig.get().runtime.output_dir)
    factory.set_threads(cfg)
    report = jobs.run_benchmark(cfg, folder)
    print(report.table())
    log.info("benchmark.json, benchmark.png and benchmark.svg are in %s", folder)


if __name__ == "__main__":
    main()
