"""Commands end in one line and a status other than 0 where there is no result."""

import sys

import pytest
from evaluated import HIT, WON, write_evaluation

from navrl.config import compose, instantiate
from navrl.factory import EvaluatedPolicy
from navrl.jobs import evaluation as building
from navrl.worlds import ScenarioBatch

TINY = ["suite=smoke", "suite.num_episodes=3", "num_worlds=3", "num_threads=1"]
TINY += ["environment.time_limit_steps=4", "progress_bar=false", "hydra.run.dir=run"]


class Raising:
    """Raise where the goal is among those that are played side by side; always without one."""

    def __init__(self, policy, goal=None):
        self._policy, self._goal = policy, goal

    def prepare(self, scenarios):
        goals = scenarios.goal.numpy().tolist()
        if self._goal is None or self._goal in goals:
            raise ZeroDivisionError("no command")
        return self._policy.prepare(scenarios) if hasattr(self._policy, "prepare") else None

    def __call__(self, tensordict):
        return self._policy(tensordict)


def run(command, words, capsys):
    """Run a command in this process; return its exit status, its output and its error lines."""
    module = __import__(f"navrl.cli.{command}", fromlist=["main"])
    sys.argv = [f"navrl-{command}", *words]
    try:
        module.main()
        status = 0
    except SystemExit as end:
        status = end.code
    told = capsys.readouterr()
    return status, told.out, [line for line in told.err.splitlines() if line.startswith("navrl: ")]


@pytest.fixture
def raising(monkeypatch, tmp_path):
    """Let the policy raise in one episode, or in all."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [])
    make = building.make_evaluated_policy

    def replace(goal):
        def contender(cfg, **options):
            found = make(cfg, **options)
            return EvaluatedPolicy(found.name, Raising(found.policy, goal), found.env)

        monkeypatch.setattr(building, "make_evaluated_policy", contender)

    return replace


@pytest.mark.slow
def test_evaluation_with_only_errors_fails(raising, capsys, tmp_path):
    raising(None)
    for _ in range(2):  # the same again after it has finished
        status, _, lines = run("evaluate", ["policy=random", *TINY], capsys)
        assert status == 2
        place = f"tracebacks are in {tmp_path / 'run' / 'errors'}"
        found = "all 3 episodes raised an error, the first: ZeroDivisionError: no command"
        assert lines == [f"navrl: policy=random: {found}; {place}"]
    assert len(list((tmp_path / "run" / "errors").iterdir())) == 3


@pytest.mark.slow
def test_errors_are_in_the_printed_line(raising, capsys, tmp_path):
    scenario = instantiate(compose("evaluate", TINY[:-1]).suite).scenarios([1])[0]
    goal = ScenarioBatch.pack([scenario]).goal[0].numpy().tolist()
    status, out, _ = run("evaluate", ["policy=random", *TINY], capsys)
    assert status == 0 and "n=3; " in out
    raising(goal)
    status, out, _ = run("evaluate", ["policy=random", *TINY[:-1], "hydra.run.dir=other"], capsys)
    assert status == 0
    errors = tmp_path / "other" / "errors"
    assert f"n=3, of which {len(list(errors.iterdir()))} raised an error ({errors}); " in out


@pytest.mark.parametrize(
    ("command", "words", "line"),
    [
        ("evaluate", ["policy=paper", "lidar.num_beams=720", *TINY], "lidar.num_beams=720: no ef"),
        ("evaluate", ["policy=random", "latency=-1", *TINY], "latency=-1: number of episodes"),
        ("play", ["policy=paper", "robot.max_speed=0.5"], "robot.max_speed=0.5: no effect"),
        ("play", ["recording=a.npz", "episode=3"], "episode=3: no effect with recording=a.npz"),
        ("train", ["suite.num_episodes=0"], "num_episodes=0: must be > 0"),
        ("train", ["suite.version=1", "suite.name=table1", "suite.seed=5"], "frozen"),
        ("train", ["+final_simulator.nothing=1"], "nothing"),
        ("benchmark", ["suite.seed=3"], "suite.seed=3: no effect"),
        ("compare", ["a", "b", "metrics=[sple]"], "metrics=['sple']: must be some of"),
        ("plot", ["picture=gif", "source=[a,b]"], "source=[a, b]: must be one"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_override_without_effect_fails_at_the_start(
    command, words, line, capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [])
    write_evaluation(tmp_path / "a", "paper", [WON, HIT])
    write_evaluation(tmp_path / "b", "dwa", [WON, HIT])
    status, _, lines = run(command, words, capsys)
    assert status == 2 and len(lines) == 1 and line in lines[0]
    assert not list(tmp_path.rglob("metrics.csv"))  # no training began


def test_a_reference_without_evaluations_is_an_error(tmp_path):
    pytest.importorskip("plotly", reason="needs the extra 'report'")
    from navrl.viz.report import write_report

    (tmp_path / "metrics.csv").write_text("frames,evaluation/success_rate\n100,0.5\n")
    with pytest.raises(ValueError, match="reference=paper: no effect"):
        write_report([tmp_path], tmp_path / "report.html", reference="paper")
