"""Hydra callbacks of sweeps: expansion of ``policy=all``, folder names, final table.

Hydra calls them before and after the jobs of ``-m``.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, cast

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, read_write

from navrl import evaluation
from navrl.config import options
from navrl.jobs.run_lock import new_folder
from navrl.policies import zoo_names

log = logging.getLogger(__name__)


class ExpandPolicies(Callback):
    """Callback that expands ``policy=all``, ``zoo`` and ``controllers``.

    They may be part of a list: ``policy=zoo,pure_pursuit,outputs/train/mine``.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Expand the command's override."""
        overrides = list(config.hydra.overrides.task)
        with read_write(config.hydra.overrides):
            config.hydra.overrides.task = [_expanded(override) for override in overrides]


class NewFolder(Callback):
    """Callback that gives each command a new folder, also within the same second.

    Only a folder named by time must be new; a folder named by the user may exist.
    """

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Create the folder of a single job."""
        if _is_named_by_time(config.hydra.run):
            with read_write(config.hydra.run):
                config.hydra.run.dir = str(new_folder(Path(config.hydra.run.dir)))

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Create the folder of a sweep, whose jobs compose their own configurations."""
        if _is_named_by_time(config.hydra.sweep):
            folder = str(new_folder(Path(config.hydra.sweep.dir)))
            with read_write(config.hydra):
                config.hydra.sweep.dir = folder
                config.hydra.overrides.hydra.append(f"hydra.sweep.dir={_quoted(folder)}")


class NameJobs(Callback):
    """Callback that names a job's folder by the overrides that differ between jobs.

    Shared overrides would make names longer without distinguishing jobs.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Exclude shared overrides from ``hydra.job.override_dirname``."""
        parsed = OverridesParser.create().parse_overrides(list(config.hydra.overrides.task))
        shared = [override.key_or_group for override in parsed if not override.is_sweep_override()]
        key = "hydra.job.config.override_dirname.exclude_keys"
        left_out = [*config.hydra.job.config.override_dirname.exclude_keys, *shared]
        with read_write(config.hydra.overrides):
            config.hydra.overrides.hydra.append(f"{key}=[{','.join(map(repr, left_out))}]")


class CompareEvaluations(Callback):
    """Callback that writes and prints the tables of all evaluations of the sweep's folder.

    Perturbed evaluations are in the table of robustness; of them only the nominal ones are in that
    of the policies.

    Args:
        reference: Policy that the others are compared with; ``None`` uses ``paper`` or, without it,
            the best that is not privileged.
    """

    def __init__(self, reference: str | None = None) -> None:
        self.reference = reference

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Compare the evaluations of this sweep and of earlier jobs in the same folder."""
        from navrl.evaluation.robustness import NOMINAL  # loads torch

        folder, texts, files = Path(config.hydra.sweep.dir), [], []
        if not any(folder.rglob("summary.json")):  # e.g. data that are not here
            return log.info("no job of the sweep has a result")
        found = evaluation.find_evaluations([folder])
        compared = [e for e in found if e.perturbation in (None, NOMINAL)]
        if compared:
            tables = evaluation.compare(compared, self.reference)
            files += evaluation.write_comparison(tables, folder)
            texts += [evaluation.markdown(table) for table in tables]
        perturbed = evaluation.robustness_tables(found)
        if perturbed:
            files += evaluation.write_robustness(perturbed, folder)
            texts += [evaluation.robustness_markdown(table) for table in perturbed]
        print("\n".join(texts))
        log.info("the tables are in %s", ", ".join(map(str, files)))


def expand_policies(names: list[str]) -> list[str]:
    """Return ``names`` with ``all``, ``zoo`` and ``controllers`` expanded.

    A controller whose optional dependency is missing is skipped with a warning.
    """
    if not {"all", "controllers"} & set(names):
        missing: dict[str, list[str]] = {}
    else:  # imported here, since it loads torch
        from navrl.factory.policy import controller_class
        from navrl.policies.controller import missing_packages

        missing = {name: missing_packages(controller_class(name)) for name in options("controller")}
    controllers = [name for name, packages in missing.items() if not packages]
    words = {"zoo": zoo_names(), "controllers": controllers, "all": [*zoo_names(), *controllers]}
    expanded = [policy for name in names for policy in words.get(name, [name])]
    for name, packages in missing.items():
        if packages:
            needed = ", ".join(packages)
            log.warning("%s is skipped: it needs %s, which is not installed", name, needed)
    return list(dict.fromkeys(expanded))


def _is_named_by_time(node: DictConfig) -> bool:
    plain = cast(dict[str, str], OmegaConf.to_container(node, resolve=False))
    return "${now:" in plain["dir"]


def _quoted(value: str) -> str:
    """Return ``value`` as a quoted string of Hydra's override grammar."""
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def _expanded(override: str) -> str:
    key, equals, value = override.partition("=")
    return (
        f"{key}{equals}{','.join(expand_policies(value.split(',')))}"
        if key == "policy"
        else override
    )
