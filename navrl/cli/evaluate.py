"""``navrl-evaluate``: play a suite with a policy; writes episodes.csv and summary.json."""

from __future__ import annotations

import logging
import math
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import factory, jobs
from navrl.cli.command import hydra_main
from navrl.factory.overrides import check_start

log = logging.getLogger(__name__)


@hydra_main("evaluate")
def main(cfg: DictConfig) -> float:
    """Evaluate a policy and return the success rate; NaN if the files of the suite are absent.

    Raises:
        ValueError: If every episode raised an exception.
    """
    check_start(cfg)
    skipped = jobs.missing_data(cfg)
    if skipped is not None:
        log.warning(skipped)
        return math.nan
    folder = Path(HydraConfig.get().runtime.output_dir)
    with jobs.locked(folder):
        return _evaluate(cfg, folder)


def _evaluate(cfg: DictConfig, folder: Path) -> float:
    factory.set_threads(cfg)
    summary = jobs.finished_evaluation(cfg, folder)
    if summary is None:
        summary = jobs.run_evaluation(cfg, folder)
    else:
        log.info("%s: finished before, not played again", folder)
    low, high = summary["success_interval"]
    errors = summary["errors"]
    log.info(
        "%s on %s%s: success %.1f %% [%.1f, %.1f], collision %.1f %%, timeout %.1f %%, n=%d%s; %s",
        summary["policy"],
        summary["suite"],
        f" under {summary['perturbation']['name']}" if summary.get("perturbation") else "",
        100 * summary["success_rate"],
        100 * low,
        100 * high,
        100 * summary["collision_rate"],
        100 * summary["timeout_rate"],
        summary["episodes"],
        f", of which {errors} raised an error ({folder / 'errors'})" if errors else "",
        folder,
    )
    jobs.check_errors(cfg, summary, folder)
    latency = jobs.measure_latency(cfg, folder)
    if latency is not None:
        log.info(
            "decisions took %.2f ms (median), 95 %% of them at most %.2f ms, n=%d",
            latency["median_ms"],
            latency["p95_ms"],
            latency["calls"],
        )
    return summary["success_rate"]


if __name__ == "__main__":
    main()
