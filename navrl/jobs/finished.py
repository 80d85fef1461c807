"""Whether an evaluation is finished, so that the same command need not play it again."""

from __future__ import annotations

import logging
from pathlib import Path

from omegaconf import DictConfig

from navrl.evaluation.archive import missing_recordings
from navrl.evaluation.results import EPISODES, SUMMARY
from navrl.evaluation.stored import whole_results
from navrl.factory.overrides import check_options, check_policy
from navrl.factory.policy import bundle_folder
from navrl.jobs.inputs import evaluation_inputs, policy_parts
from navrl.jobs.run_folder import claim_folder

log = logging.getLogger(__name__)


def finished_evaluation(cfg: DictConfig, folder: Path) -> dict | None:
    """Return the summary of the evaluation in ``folder`` if it needs no repetition.

    Raises:
        ValueError: If ``folder`` holds an evaluation of another configuration, or an override is
            out of range or has no effect.
    """
    check_options(cfg)
    check_policy(cfg, is_bundle=bundle_folder(cfg.policy) is not None)
    claim_folder(cfg, folder)
    return unchanged_evaluation(cfg, folder)


def unchanged_evaluation(cfg: DictConfig, folder: Path) -> dict | None:
    """Return the summary in ``folder`` if the same would be played again with the same result.

    Policy, configuration and code are compared by their hashes, and the episodes with theirs, so
    neither the time of a file nor a part of one counts. What is missing or differs is logged.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        folder: Of the evaluation.
    """
    if not (folder / SUMMARY).exists():
        return None
    summary = whole_results(folder)
    if summary is None:
        differs = [f"{SUMMARY} or {EPISODES} is missing or damaged"]
    else:
        known = evaluation_inputs(cfg, policy_parts(cfg))
        differs = [name for name, value in known.items() if summary.get(name) != value]
        if missing_recordings(folder, cfg.get("recordings", "none")):
            differs.append("recordings are missing")
        if summary["errors"] == summary["episodes"]:
            differs.append("every episode raised")
    if differs:
        log.info("%s: played again: %s", folder, ", ".join(differs))
        return None
    return summary
