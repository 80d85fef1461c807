"""A search prunes, resumes interrupted trials and repeats none."""

import csv
import sys
from signal import SIGTERM

import pytest
from runs import TINY

from navrl.config import compose
from navrl.jobs.publishing import publish
from navrl.training import TrainingStoppedError

optuna = pytest.importorskip("optuna")
from navrl.jobs import searching  # noqa: E402

BASE = [*TINY, "logger=none", "schedule.total_frames=200", "schedule.evaluate_every_updates=6"]
SPACE = ["algorithm.gamma=interval(0.9,0.99)", "network=choice(small)", "seed=range(0,3)"]
QUOTED = "space=[" + ",".join(f'"{text}"' for text in SPACE) + "]"


class FakeTrainer:
    """A training of three validations; ``curves`` has their success rates by trial."""

    curves = ()
    started = ()

    def __init__(self, cfg, folder):
        self.cfg, self.folder, self.on_evaluated = cfg, folder, None
        (folder / "checkpoint").mkdir(exist_ok=True)
        FakeTrainer.started = (*FakeTrainer.started, folder.name)

    def run(self):
        for index, rate in enumerate(FakeTrainer.curves[len(FakeTrainer.started) - 1]):
            if isinstance(rate, Exception):
                raise rate
            metrics = {"success_rate": rate, "frames": 100.0 * (index + 1), "curriculum_level": 0}
            self.on_evaluated(metrics)


@pytest.fixture
def fake(monkeypatch):
    def curves(*rates):
        FakeTrainer.curves, FakeTrainer.started = rates, ()

    monkeypatch.setattr(searching, "make_trainer", FakeTrainer)
    return curves


def run(folder, *more):
    folder.mkdir(exist_ok=True)
    overrides = [*BASE, QUOTED, "prune.startup_trials=1", *more]
    return searching.search(compose("search", overrides), overrides, folder)


def states(study):
    return [trial.state.name for trial in study.trials]


def test_space_has_hydras_syntax():
    space = searching.search_space(
        [*SPACE, "a.b=tag(log,interval(1e-5,1e-3))", "n=range(1,8,3)", "schedule=choice(quick,x)"]
    )
    assert (space["algorithm.gamma"].low, space["algorithm.gamma"].high) == (0.9, 0.99)
    assert space["a.b"].log and not space["algorithm.gamma"].log
    assert (space["seed"].low, space["seed"].high) == (0, 2)
    assert (space["n"].low, space["n"].high, space["n"].step) == (1, 7, 3)
    assert space["schedule"].choices == ("quick", "x")


@pytest.mark.parametrize("text", ["a=1", "a=interval(2,1)", "a", "a=tag(log,interval(0,1))"])
def test_invalid_space_is_one_clear_error(text):
    with pytest.raises(ValueError, match=r"space=.*must be KEY=interval\(a,b\)"):
        searching.search_space([text])


def test_trial_below_the_median_is_pruned(fake, tmp_path):
    fake([0.2, 0.6, 0.8], [0.1, 0.9, 0.9], [0.3, 0.7, 0.9])
    study = run(tmp_path, "trials=3")
    assert states(study) == ["COMPLETE", "PRUNED", "COMPLETE"]
    assert study.best_value == 0.9 and study.best_trial.number == 2
    rows = list(csv.DictReader((tmp_path / "trials.csv").open()))
    assert [row["state"] for row in rows] == ["complete", "pruned", "complete"]
    assert [row["frames"] for row in rows] == ["300", "100", "300"]
    assert all(0.9 <= float(row["algorithm.gamma"]) <= 0.99 for row in rows)
    assert len({row["algorithm.gamma"] for row in rows}) == 3
    assert not list(tmp_path.glob("*/checkpoint"))


def test_interrupted_trial_continues_in_its_folder(fake, tmp_path):
    fake([0.5, 0.6, 0.7], [0.6, TrainingStoppedError(SIGTERM, "100 frames", tmp_path)])
    with pytest.raises(TrainingStoppedError):
        run(tmp_path, "trials=3")
    assert (tmp_path / "trial_001" / "checkpoint").is_dir()
    fake([0.6, 0.8, 0.9], [0.9, 0.9, 0.95])
    study = run(tmp_path, "trials=3")
    assert FakeTrainer.started == ("trial_001", "trial_003")
    assert states(study) == ["COMPLETE", "FAIL", "COMPLETE", "COMPLETE"]
    failed, continued = study.trials[1:3]
    assert failed.params == continued.params
    assert continued.intermediate_values == {100: 0.6, 200: 0.8, 300: 0.9}
    fake()
    assert states(run(tmp_path, "trials=3")) == states(study)  # nothing is repeated
    assert FakeTrainer.started == ()


def test_trials_and_prune_are_checked(tmp_path):
    for override, message in (
        ("trials=0", "trials=0: must be an integer of at least 1"),
        ("resume=x", "resume=x: must be null"),
        ("prune.warmup_frames=-1", "must have startup_trials and warmup_frames"),
    ):
        with pytest.raises(ValueError, match=message):
            run(tmp_path, override)


def test_missing_optuna_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr("navrl.extras.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r"navrl-search: needs optuna; .*\[search\]"):
        run(tmp_path)


@pytest.mark.slow
def test_command_trains_prunes_and_resumes(tmp_path, monkeypatch, capsys):
    from navrl.cli.search import main

    words = [*BASE, QUOTED, "prune=null", f"hydra.run.dir={tmp_path / 'study'}"]
    for trials in (1, 2):
        monkeypatch.setattr(sys, "argv", ["navrl-search", *words, f"trials={trials}"])
        main()
    rows = list(csv.DictReader((tmp_path / "study" / "trials.csv").open()))
    assert [row["folder"] for row in rows] == ["trial_000", "trial_001"]
    for row in rows:
        log = list(csv.DictReader((tmp_path / "study" / row["folder"] / "metrics.csv").open()))
        rates = [float(x["evaluation/success_rate"]) for x in log if x["evaluation/success_rate"]]
        assert float(row["value"]) == pytest.approx(max(rates))
        assert (tmp_path / "study" / row["folder"] / "config.yaml").is_file()
    publish(tmp_path / "study" / "trial_001", tmp_path / "mine")
    assert "algorithm.gamma=0.9" in (tmp_path / "mine" / "card.md").read_text()
    text = (tmp_path / "study" / "search.log").read_text()
    assert "best of 2 trials" in text and "navrl-train num_worlds=4" in text
    assert "\033" not in text and "space=" not in text
