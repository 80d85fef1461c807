"""Detection of finished evaluations, which the same command does not repeat."""

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
    """Return the summary of a finished evaluation in ``folder``, or ``None``.

    Raises:
        ValueError: If ``folder`` has an evaluation of another configuration, or an override is
            out of range or has no effect.
    """
    check_options(cfg)
    check_policy(cfg, is_bundle=bundle_folder(cfg.policy) is not None)
    claim_folder(cfg, folder)
    return unchanged_evaluation(cfg, folder)


def unchanged_evaluation(cfg: DictConfig, folder: Path) -> dict | None:
    """Return the summary in ``folder`` if a repetition would give the same result.

    Policy, configuration, code and episodes are compared by hash, so file times and incomplete
    files are not an issue. Missing files and differences are logged.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        folder: Folder of the evaluation.
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
