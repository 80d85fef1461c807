"""Section of a model card that lists what is needed to repeat the training and its scores."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from navrl.evaluation import Evaluation
from navrl.files import markdown_text
from navrl.jobs.run_folder import CONFIG_FILE, load_config
from navrl.training.provenance import recorded_origins
from navrl.untrusted import read_yaml

RUN_CONFIG = "run.yaml"
_REMEDY = "restore it, or delete it"
_IGNORED = ("hydra.", "policy=", "progress_bar=", "num_processes=", "num_threads=")


def repetition(run: Path, name: str, evaluations: Sequence[Evaluation]) -> str:
    """Return the section "To repeat" of the card.

    Args:
        run: Folder of ``navrl-train``.
        name: Name of the bundle.
        evaluations: Evaluations of the policy.

    Returns:
        Code version, packages, seed, configuration, and a command for each score.
    """
    lines = ["To repeat:", ""]
    origins = recorded_origins(run)
    if origins:
        lines.append(f"- code, packages and machine: {markdown_text(origins[-1])}")
    if any("-dirty" in origin for origin in origins):
        lines.append("- the code had changes that are not part of that commit")
    if (run / CONFIG_FILE).is_file():
        cfg = load_config(run / CONFIG_FILE)
        threads = cfg.get("num_threads") or "those of idle cores"
        lines.append(
            f"- seed {cfg.get('seed')}, device {cfg.get('device', 'cpu')}, threads {threads}; "
            f"{RUN_CONFIG} has the whole configuration, defaults of that version included"
        )
    if len(origins) > 1:
        lines.append(f"- the run was resumed {len(origins) - 1} times")
    commands = [_command(evaluation, name) for evaluation in evaluations]
    if any(commands):
        lines += ["", "```", *filter(None, commands), "```"]
    return "\n".join(lines) if len(lines) > 2 else ""


def _command(evaluation: Evaluation, name: str) -> str:
    """Return the command of an evaluation with the bundle as policy; empty if not recorded."""
    file = Path(evaluation.folder) / ".hydra" / "overrides.yaml"
    if not file.is_file():
        return ""
    words = [str(word) for word in read_yaml(file, _REMEDY, list)]
    kept = [word for word in words if not word.startswith(_IGNORED)]
    return " ".join(shlex.join(["navrl-evaluate", f"policy={name}", *kept]).split("\n"))
