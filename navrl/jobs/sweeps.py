"""What surrounds a sweep: what ``policy=all`` means, how jobs are called, one table at the end.

Hydra calls these before and after the jobs of ``-m``; the config names them as its callbacks.
"""

from __future__ import annotations

import importlib.util
import logging
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, read_write

from navrl import evaluation
from navrl.config import CONF_DIR
from navrl.jobs.run_lock import new_folder
from navrl.policies import zoo_names

log = logging.getLogger(__name__)

_NEEDS = {"orca": "pyrvo"}  # controllers with an optional dependency


class ExpandPolicies(Callback):
    """Let ``policy=all`` (or ``zoo``, or ``controllers``) stand for what there is.

    The word may be one of several: ``policy=zoo,pure_pursuit,outputs/train/mine``.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Replace the word in the command's overrides."""
        overrides = list(config.hydra.overrides.task)
        with read_write(config.hydra.overrides):
            config.hydra.overrides.task = [_expanded(override) for override in overrides]


class NewFolder(Callback):
    """Give each command a folder of its own, also those that start within one second.

    Only a folder that is named by the time is new; one that the user names may be there already.
    """

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Make the folder of a single job."""
        if _is_named_by_time(config.hydra.run):
            with read_write(config.hydra.run):
                config.hydra.run.dir = str(new_folder(Path(config.hydra.run.dir)))

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Make the folder of a sweep, whose jobs compose their configurations anew."""
        if _is_named_by_time(config.hydra.sweep):
            folder = str(new_folder(Path(config.hydra.sweep.dir)))
            with read_write(config.hydra):
                config.hydra.sweep.dir = folder
                config.hydra.overrides.hydra.append(f"hydra.sweep.dir={_quoted(folder)}")


class NameJobs(Callback):
    """Call a job's folder only by what differs between jobs.

    What all jobs share would make every name long and tell none from another.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Leave the overrides that are no choice out of ``hydra.job.override_dirname``."""
        parsed = OverridesParser.create().parse_overrides(list(config.hydra.overrides.task))
        shared = [override.key_or_group for override in parsed if not override.is_sweep_override()]
        key = "hydra.job.config.override_dirname.exclude_keys"
        left_out = [*config.hydra.job.config.override_dirname.exclude_keys, *shared]
        with read_write(config.hydra.overrides):
            config.hydra.overrides.hydra.append(f"{key}=[{','.join(map(repr, left_out))}]")


class CompareEvaluations(Callback):
    """Write one table of all evaluations in the sweep's folder, and print it.

    Args:
        reference: The policy that the others are compared with; ``None`` is ``paper`` or, without
            it, the best that does not read the true state.
    """

    def __init__(self, reference: str | None = None) -> None:
        self.reference = reference

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Read what the jobs left, and jobs of the same folder before them."""
        folder = Path(config.hydra.sweep.dir)
        tables = evaluation.compare(evaluation.find_evaluations([folder]), self.reference)
        files = evaluation.write_comparison(tables, folder)
        print("\n".join(evaluation.markdown(table) for table in tables))
        log.info("the tables are in %s", ", ".join(map(str, files)))


def expand_policies(names: list[str]) -> list[str]:
    """Return ``names`` with ``all``, ``zoo`` and ``controllers`` replaced by what they stand for.

    A controller whose optional dependency is missing is left out with a warning.
    """
    controllers = [name for name in _controllers() if _is_installed(name)]
    words = {"zoo": zoo_names(), "controllers": controllers, "all": [*zoo_names(), *controllers]}
    expanded = [policy for name in names for policy in words.get(name, [name])]
    if any(name in words and name != "zoo" for name in names):
        for name in sorted(set(_controllers()) - set(controllers)):
            log.warning("%s is left out: it needs %s, which is not installed", name, _NEEDS[name])
    return list(dict.fromkeys(expanded))


def _is_named_by_time(node: DictConfig) -> bool:
    return "${now:" in OmegaConf.to_container(node, resolve=False)["dir"]


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


def _controllers() -> list[str]:
    return sorted(path.stem for path in (CONF_DIR / "controller").glob("*.yaml"))


def _is_installed(controller: str) -> bool:
    module = _NEEDS.get(controller)
    return module is None or importlib.util.find_spec(module) is not None
