"""Publishing of a run's best policy as a bundle with a model card."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from omegaconf import OmegaConf

from navrl.config import compose
from navrl.evaluation import Evaluation, find_evaluations
from navrl.factory.policy import bundle_folder, with_parts
from navrl.files import csv_text, markdown_text, write_text
from navrl.jobs.inputs import bundle_files, policy_hash
from navrl.jobs.repetition import RUN_CONFIG, repetition
from navrl.jobs.run_folder import CONFIG_FILE
from navrl.policies import load_bundle, save_bundle, zoo_names
from navrl.training.provenance import recorded_origins
from navrl.untrusted import DamagedFileError, is_number, read_table, read_text, read_yaml

CURVE = "curve.csv"
_CURVE_COLUMNS = {
    "frames": "environment steps",
    "updates": "updates",
    "evaluation/max_dynamic": "pedestrians at most",
    "evaluation/success_rate": "success",
    "evaluation/collision_pedestrian_rate": "into a pedestrian",
    "evaluation/collision_static_rate": "into a wall",
    "evaluation/timeout_rate": "timeout",
}
_LAST = "policy_last"  # folder in that of a run
_BEST = "the best of the highest curriculum level on the validation episodes."
_SHOWN = 10  # maximum rows of the curve in the card
_IGNORED_OVERRIDES = ("hydra.", "resume=", "progress_bar=")


def publish(
    run: str | Path,
    out: str | Path,
    evaluations: Sequence[str | Path] = (),
    about: str = "",
    half: bool = False,
    last: bool = False,
) -> Path:
    """Write a bundle of a run's best or last policy and its model card.

    Args:
        run: Folder of ``navrl-train``.
        out: Folder of the bundle, named like the policy.
        evaluations: Folders of ``navrl-evaluate`` with this policy, searched recursively.
        about: A sentence that describes the policy.
        half: Whether weights are stored as float16, in half the space. Then evaluate this bundle
            instead of the run.
        last: Whether the policy is that of the last validation instead of the best one; rates that
            fall to zero at the end often make it the better one.

    Returns:
        ``out``, with the bundle's files, the learning curve in ``curve.csv`` and the configuration
        of the run in ``run.yaml``.

    Raises:
        BundleError: If the run has no policy, or a damaged one.
        FileNotFoundError: If the run has no log.
        ValueError: If a folder has no evaluation, or one of another policy than the run's or that
            of an existing bundle in ``out``, or the policy's metrics lack the duration of training.
    """
    run, out = Path(run), Path(out)
    policy = run / (_LAST if last else "policy")
    bundle = load_bundle(policy)
    curve = _read_curve(run / "metrics.csv")
    config = {name: value for name, value in bundle.config.items() if name != "format"}
    found = find_evaluations(evaluations) if evaluations else []
    _check_policy(found, [folder for folder in (policy, out) if bundle_folder(str(folder))])
    actor = bundle.actor.half() if half else bundle.actor
    count = sum(weight.numel() for weight in actor.parameters())
    parts = [
        f"# {out.name}",
        f"{about} {count:,} parameters an actor.".strip(),
        _origin(run, policy, bundle.metrics),
        _scores(found),
        repetition(run, out.name, found),
        _curve_table(curve),
    ]
    card = "\n\n".join(part for part in parts if part) + "\n"
    save_bundle(out, config=config, actor=actor, metrics=bundle.metrics, card=card)
    write_text(out / CURVE, csv_text(list(_CURVE_COLUMNS), curve))
    if (run / CONFIG_FILE).is_file():
        write_text(out / RUN_CONFIG, read_text(run / CONFIG_FILE, "restore it"))
    return out


def publish_extended(
    policy: str | Path,
    out: str | Path,
    steps: Sequence[str],
    evaluations: Sequence[str | Path] = (),
    about: str = "",
) -> Path:
    """Write a bundle with the network of another one and a pipeline with further steps.

    Args:
        policy: Bundle: a name in the zoo or a folder.
        out: Folder of the new bundle, named like the policy.
        steps: Options of the group ``transforms/steps``, as in ``change.transforms``.
        evaluations: Folders of ``navrl-evaluate`` with the new bundle, searched recursively.
        about: A sentence that describes the policy.

    Returns:
        ``out``, with the new bundle's files and the learning curve of the other one.

    Raises:
        BundleError: If the bundle is damaged.
        ValueError: If there is no such bundle or step, or an evaluation is of another policy.
    """
    folder, out = bundle_folder(str(policy)), Path(out)
    if folder is None:
        raise ValueError(f"policy={policy}: must be a bundle or one of {', '.join(zoo_names())}")
    added = f"+transforms/steps@change.transforms=[{','.join(steps)}]"
    cfg = compose("evaluate", [f"policy={folder}", added])
    bundle = load_bundle(folder)
    changed = with_parts(cfg, bundle.config)
    config = {name: value for name, value in bundle.config.items() if name != "format"}
    config["transforms"] = OmegaConf.to_container(changed.transforms, resolve=True)
    found = find_evaluations(evaluations) if evaluations else []
    _check_policy(found, [out] if bundle_folder(str(out)) else [])
    source = (folder / "card.md").read_text().partition("\nScores")[0].partition("Trained by")[2]
    extended = f"The network of `{folder.name}` with the steps {', '.join(steps)}."
    parts = [f"# {out.name}", f"{about} {extended}".strip(), f"Trained by{source}", _scores(found)]
    card = "\n\n".join(part.strip() for part in parts if part) + "\n"
    save_bundle(out, config=config, actor=bundle.actor, metrics=bundle.metrics, card=card)
    if (folder / CURVE).is_file():
        write_text(out / CURVE, (folder / CURVE).read_text())
    load_bundle(out)  # the new pipeline is allowed in a bundle
    return out


def _check_policy(evaluations: Sequence[Evaluation], bundles: Sequence[Path]) -> None:
    """Check that evaluations with a policy hash belong to one of the bundles.

    Raises:
        ValueError: If the policy is another one, or was modified by ``change`` or a perturbation.
    """
    known = {policy_hash(bundle_files(folder)) for folder in bundles}
    for evaluation in evaluations:
        hashed = evaluation.summary.get("policy_hash")
        is_modified = evaluation.summary.get("change") or evaluation.perturbation is not None
        if is_modified or (hashed is not None and hashed not in known):
            raise ValueError(
                f"evaluations={evaluation.folder}: of another policy, {evaluation.label}; must be "
                f"of {' or '.join(map(str, bundles))}"
            )


def _read_curve(file: Path) -> list[dict[str, str]]:
    remedy = "restore the run's log"
    rows = read_table(file, remedy, is_log=True)
    rows = [row for row in rows if row.get("evaluation/success_rate")]
    curve = [{name: row.get(name) or "" for name in _CURVE_COLUMNS} for row in rows]
    try:
        _ = [float(cell or "nan") for row in curve for cell in row.values()]
    except ValueError as error:
        raise DamagedFileError(file, f"must hold numbers ({error})", remedy) from error
    return curve


def _origin(run: Path, policy: Path, metrics: dict) -> str:
    remedy = "restore it, or write [] into it and the command into the card"
    overrides = map(str, read_yaml(run / ".hydra" / "overrides.yaml", remedy, list))
    words = [word for word in overrides if not word.startswith(_IGNORED_OVERRIDES)]
    command = " ".join(shlex.join(["navrl-train", *words]).split("\n"))  # no line breaks
    parts = "; ".join(map(markdown_text, recorded_origins(run))) or "origin not recorded"
    missing = [n for n in ("seconds", "updates", "frames") if not is_number(metrics.get(n), 0)]
    if missing:
        raise ValueError(f"{policy / 'metrics.json'}: {missing} missing or no numbers")
    minutes = metrics["seconds"] / 60
    return (
        f"Trained by\n\n```\n{command}\n```\n\n"
        f"({parts}) in {minutes:.0f} minutes, {metrics['updates']:,.0f} updates and "
        f"{metrics['frames']:,.0f} environment steps to this checkpoint, "
        + ("the last." if policy.name == _LAST else _BEST)
    )


def _scores(evaluations: Sequence[Evaluation]) -> str:
    if not evaluations:
        return ""
    lines = [
        "Scores, never seen in training, with 95 % Wilson intervals:",
        "",
        "| suite | hash | simulator | episodes | success | collision | timeout | time to goal |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for evaluation in evaluations:
        summary = evaluation.summary
        rates = " | ".join(_rate(summary, name) for name in ("success", "collision", "timeout"))
        seconds = summary.get("navigation_time_s")
        time = "-" if seconds is None else f"{seconds:.1f} s"
        lines.append(
            f"| {' | '.join(map(markdown_text, evaluation.setting_shown))} | "
            f"{summary['episodes']} | {rates} | {time} |"
        )
    return "\n".join(lines)


def _rate(summary: Mapping, name: str) -> str:
    if f"{name}_interval" not in summary:
        return f"{100 * summary[f'{name}_rate']:.1f} %"
    low, high = summary[f"{name}_interval"]
    return f"{100 * summary[f'{name}_rate']:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


def _curve_table(curve: Sequence[dict[str, str]]) -> str:
    step = -(-len(curve) // _SHOWN) or 1
    shown = curve[::-1][::step][::-1]  # includes the last one
    lines = [
        "Learning curve on the validation episodes at the curriculum level of the time "
        f"({CURVE} has all):",
        "",
        "| " + " | ".join(_CURVE_COLUMNS.values()) + " |",
        "|" + "---|" * len(_CURVE_COLUMNS),
    ]
    for row in shown:
        cells = [_cell(name, value) for name, value in row.items()]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(name: str, value: str) -> str:
    if not value:
        return "-"
    return f"{100 * float(value):.1f} %" if name.endswith("_rate") else f"{float(value):,.0f}"
