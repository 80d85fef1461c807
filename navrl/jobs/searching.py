"""Search over hyper-parameters of a training, with pruning and resuming."""

from __future__ import annotations

import logging
import math
import shlex
import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, RangeSweep
from hydra.errors import HydraException
from omegaconf import DictConfig

from navrl.config import compose
from navrl.extras import require
from navrl.factory.training import make_trainer
from navrl.files import csv_text, write_text
from navrl.jobs.resuming import record_config
from navrl.jobs.run_folder import claim_folder
from navrl.training.provenance import record_command

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.distributions import BaseDistribution
    from optuna.pruners import BasePruner

LOG = logging.getLogger(__name__)
OWN_KEYS = ("space", "trials", "prune")
"""Keys of ``conf/search.yaml`` that ``navrl-train`` does not have."""
STUDY, TRIALS = "study.db", "trials.csv"


def search(cfg: DictConfig, overrides: Sequence[str], folder: Path) -> Study:
    """Train with different hyper-parameters and return the study.

    A trial that was interrupted continues from its checkpoint; finished and pruned ones are not
    repeated. The value of a trial is that of its best validation: curriculum level plus success
    rate.

    Args:
        cfg: A composed ``conf/search.yaml``.
        overrides: Overrides of the command.
        folder: Folder of the study: ``study.db``, ``trials.csv`` and a run folder per trial.

    Raises:
        ModuleNotFoundError: If optuna is not installed.
        TrainingStoppedError: If a signal was received; the same search resumes.
        ValueError: If the space, the number of trials or ``prune`` is invalid.
    """
    require("search", "navrl-search", "optuna")
    import optuna

    optuna.logging.disable_default_handler()  # it colors lines in files, too
    optuna.logging.enable_propagation()
    space = search_space(cfg.space)
    if cfg.resume is not None:
        raise ValueError(f"resume={cfg.resume}: must be null, the same search resumes its trials")
    if not isinstance(cfg.trials, int) or cfg.trials < 1:
        raise ValueError(f"trials={cfg.trials}: must be an integer of at least 1")
    storage = f"sqlite:///{(folder / STUDY).resolve()}"
    study = optuna.create_study(
        storage=storage, study_name="navrl", direction="maximize", load_if_exists=True
    )
    study.pruner = _make_pruner(cfg.prune)
    study.sampler = optuna.samplers.TPESampler(seed=cfg.seed + len(study.trials))
    _queue_interrupted(study)
    fixed = [o for o in overrides if o.lstrip("+").partition("=")[0].split(".")[0] not in OWN_KEYS]
    train = partial(_train, fixed=fixed, space=space, folder=folder)
    done = study.get_trials(deepcopy=False, states=_done_states())
    try:
        if len(done) < cfg.trials:
            study.optimize(train, n_trials=cfg.trials - len(done))
    finally:
        _write_trials(study, folder / TRIALS)
    _log_best(study, fixed)
    return study


def search_space(space: Sequence[str]) -> dict[str, BaseDistribution]:
    """Return the distribution of each searched key.

    Args:
        space: Overrides in Hydra's syntax: ``key=interval(a,b)``, ``key=tag(log,interval(a,b))``,
            ``key=range(a,b[,step])`` (``b`` excluded) or ``key=choice(x,y)``.

    Raises:
        ValueError: If one is none of these.

    Example:
        >>> search_space(["seed=range(0,4)"])
        {'seed': IntDistribution(high=3, log=False, low=0, step=1)}
    """
    found = {}
    for text in space:
        try:
            (parsed,) = OverridesParser.create().parse_overrides([str(text)])
            found[parsed.key_or_group] = _distribution(parsed.value())
        except (HydraException, ValueError, TypeError, ZeroDivisionError) as error:
            reason = str(error).strip().splitlines()[0]
            raise ValueError(
                f"space={text}: must be KEY=interval(a,b), KEY=tag(log,interval(a,b)), "
                f"KEY=range(a,b) or KEY=choice(x,y) ({reason})"
            ) from error
    if not found:
        raise ValueError("space=[]: must have at least one override")
    return found


def _distribution(value: object) -> BaseDistribution:
    from optuna.distributions import (
        CategoricalDistribution,
        FloatDistribution,
        IntDistribution,
    )

    if isinstance(value, IntervalSweep):
        assert value.start is not None and value.end is not None  # required by the grammar
        return FloatDistribution(value.start, value.end, log="log" in value.tags)
    if isinstance(value, RangeSweep):
        first, last, step = value.start, value.stop, value.step
        if not (isinstance(first, int) and isinstance(last, int) and isinstance(step, int)):
            raise ValueError("a range must have integers")
        return IntDistribution(first, last - 1 - (last - 1 - first) % step, step=step)
    if isinstance(value, ChoiceSweep):
        return CategoricalDistribution([str(choice) for choice in value.list])
    raise ValueError("not a sweep")


def _make_pruner(prune: Mapping[str, int] | None) -> BasePruner:
    from optuna.pruners import MedianPruner, NopPruner

    if prune is None:
        return NopPruner()
    values = dict(prune)
    wrong = {k: v for k, v in values.items() if not isinstance(v, int) or v < 0}
    if wrong or values.keys() != {"startup_trials", "warmup_frames"}:
        raise ValueError(
            f"prune={values}: must have startup_trials and warmup_frames, integers of at least 0"
        )
    return MedianPruner(values["startup_trials"], values["warmup_frames"])


def _train(
    trial: Trial, fixed: Sequence[str], space: Mapping[str, BaseDistribution], folder: Path
) -> float:
    """Train one trial; return its value.

    Raises:
        TrialPruned: If the validation curve is below the median of the other trials.
    """
    from optuna import TrialPruned

    chosen = [f"{key}={_suggest(trial, key, kind)}" for key, kind in space.items()]
    run = folder / trial.user_attrs.get("folder", f"trial_{trial.number:03d}")
    trial.set_user_attr("folder", run.name)
    trial.set_user_attr("overrides", chosen)
    cfg = compose("train", [*fixed, *chosen])
    claim_folder(cfg, run)
    write_text(run / ".hydra" / "overrides.yaml", yaml.safe_dump([*fixed, *chosen]))
    record_command(run)
    record_config(cfg, run)
    trainer = make_trainer(cfg, run)
    curve = {int(step): value for step, value in trial.user_attrs.get("curve", {}).items()}
    for step, value in curve.items():  # of an interrupted trial that this one continues
        trial.report(value, step)
    trainer.on_evaluated = _reporting(trial, curve, trainer.on_evaluated)
    try:
        trainer.run()
    except TrialPruned:
        shutil.rmtree(run / "checkpoint", ignore_errors=True)  # mostly the replay buffer
        raise
    shutil.rmtree(run / "checkpoint", ignore_errors=True)
    return max(curve.values(), default=-math.inf)


def _suggest(trial: Trial, key: str, kind: BaseDistribution) -> object:
    """Return the value of a key in a trial, drawn from its distribution."""
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if isinstance(kind, FloatDistribution):
        return trial.suggest_float(key, kind.low, kind.high, log=kind.log)
    if isinstance(kind, IntDistribution):
        return trial.suggest_int(key, kind.low, kind.high, step=kind.step)
    assert isinstance(kind, CategoricalDistribution)
    return trial.suggest_categorical(key, kind.choices)


def _reporting(
    trial: Trial, curve: dict[int, float], save: Callable[[Mapping[str, float]], None] | None
) -> Callable[[Mapping[str, float]], None]:
    """Return a callback of the trainer that also reports a validation to the study."""
    from optuna import TrialPruned

    def report(metrics: Mapping[str, float]) -> None:
        if save is not None:
            save(metrics)
        frames = int(metrics["frames"])
        if frames not in curve:  # a resumed training may repeat its last validation
            curve[frames] = metrics["curriculum_level"] + metrics["success_rate"]
            trial.report(curve[frames], frames)
        if trial.should_prune():
            raise TrialPruned(f"below the median at {frames} frames")

    return report


def _done_states() -> tuple:
    from optuna.trial import TrialState

    return TrialState.COMPLETE, TrialState.PRUNED


def _queue_interrupted(study: Study) -> None:
    """Queue trials again that were interrupted, in their folders; they keep their parameters."""
    from optuna.trial import TrialState

    for trial in study.get_trials(deepcopy=False, states=[TrialState.RUNNING]):
        study.tell(trial.number, state=TrialState.FAIL)  # of a killed process
    trials = study.get_trials(deepcopy=False)
    ended = {t.user_attrs.get("folder") for t in trials if t.state != TrialState.FAIL}
    interrupted = {t.user_attrs.get("folder"): t for t in trials if t.state == TrialState.FAIL}
    for folder, trial in interrupted.items():
        if folder is not None and folder not in ended:
            curve = {str(step): value for step, value in trial.intermediate_values.items()}
            study.enqueue_trial(trial.params, user_attrs={"folder": folder, "curve": curve})


def _write_trials(study: Study, file: Path) -> None:
    trials = [t for t in study.get_trials(deepcopy=False) if t.state in _done_states()]
    keys = list(dict.fromkeys(key for trial in trials for key in trial.params))
    rows = [
        {
            "folder": trial.user_attrs["folder"],
            "state": trial.state.name.lower(),
            "value": max(trial.intermediate_values.values(), default=""),
            "frames": trial.last_step,
            **trial.params,
        }
        for trial in trials
    ]
    write_text(file, csv_text(["folder", "state", "value", "frames", *keys], rows))


def _log_best(study: Study, fixed: Sequence[str]) -> None:
    complete = [trial for trial in study.get_trials(deepcopy=False) if trial.value is not None]
    if not complete:
        return
    best = study.best_trial
    command = shlex.join(["navrl-train", *fixed, *best.user_attrs["overrides"]])
    LOG.info("best of %d trials, validation %.3f: %s", len(study.trials), best.value, command)
