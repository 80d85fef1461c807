"""Commands that README and docs print run, on fewer and shorter episodes, or are composed."""

import hashlib
import itertools
import json
import re
import shlex
import shutil
import sys
from contextlib import nullcontext
from pathlib import Path

import pages
import pytest
from made_bags import driven
from omegaconf import OmegaConf

from navrl.config import CONF_DIR, compose

# What the commands of a program are shortened by: words that set a key take its place.
EPISODES = ("environment.time_limit_steps=3", "progress_bar=false", "num_threads=1")
SHORTER = {
    "navrl-train": (*pages.TINY_TRAINING, "seed=0"),
    "navrl-evaluate": (*EPISODES, "suite.num_episodes=2", "num_worlds=2"),
    "navrl-play": ("environment.time_limit_steps=3", "num_threads=1"),
    "navrl-benchmark": (
        *("effort=quick", "effort.repeats=2", "effort.seconds=0.01"),
        *("num_worlds=4", "num_threads=1", "pool_size=4"),
    ),
    "navrl-compare": (),
    "navrl-plot": (),
    "navrl-publish": (),
    "navrl-export": ("environment.time_limit_steps=3", "num_threads=1", "golden_steps=2"),
    "navrl-report": (),
    "navrl-suites": (),
    "navrl-search": (*pages.TINY_TRAINING, "trials=2"),
    "navrl-train-flow": (
        *("policy=pure_pursuit", "scenario=corridor", "num_worlds=4", "rounds=2", "updates=2"),
        *("recorder.num_steps=4", "training.batch_size=2", "progress_bar=false"),
    ),
    "navrl-doctor": ("policy=paper", "training_scan=false"),
    "navrl-replay": ("policy=paper", "duration_s=0.5"),
}
RUN = "outputs/train/2026-11-23_12-00-00"
MINE = "navrl-train --config-dir my_conf experiment=mine"
# A run of somebody's; a policy that takes no time; a suite whose episodes are soon made anew.
STANDS_FOR = {
    "resume=FOLDER": f"resume={RUN}",
    "resume=outputs/train/<time>": f"resume={RUN}",
    "RUN OUT --evaluations FOLDER": f"{RUN} bundle --evaluations {RUN}/evaluation",
    "recording=FILE": f"recording={RUN}/episode.npz",
    "experiment=NAME": "experiment=paper",
    "source=navrl/policies/zoo": f"source={pages.ROOT / 'navrl/policies/zoo'}",
    "policy=FOLDER": "policy=paper",
    "policy=PATH": "policy=paper",
    "000017.npz": "000001.npz",
    "navrl-suites check table1": "navrl-suites check validation",
    "navrl-suites freeze": "navrl-suites freeze validation",
}
# Policies of sweeps that are not played whole; tests/cli/test_evaluation_sweep.py has the words.
FEWER = {
    "policy=all simulator=bullet": "policy=paper,dwa simulator=bullet",
    "policy=all": "policy=stand_still,dwa",
    "policy=zoo,dwa": "policy=paper,dwa",
}
# Several machines, a scheduler or a service that a test has not: what they choose is composed.
ELSEWHERE = ("address=auto", "submitit", "slurm", "launcher=ray_cluster", "collector=ray")
# What may be missing here, hardware or an optional dependency, which must be told in a line.
NEEDS = {
    **{"device=cuda": "cuda", "hardware=gpu": "cuda", "rows=[gpu]": "cuda"},
    **{"gui=true": "display", "mp4": "ffmpeg", "picture=rerun": "rerun"},
    **{
        "navrl-export": "onnxruntime",
        "navrl-search": "optuna",
        "navrl-report": "plotly",
        "launcher=cores": "joblib",
    },
}
# Run by CI itself, or no command of ours: exactly these.
OTHERS = {
    "python -m build",  # docs/releasing.md: tests/test_packaging.py builds and lists the wheel
    "NAVRL_REPOSITORY_URL=",
    "python -m zipfile",
    "python -m pytest --run-slow",
    "python3 -m venv smoke",
    "bin/",
    "git tag",
    "git push",
    "mike ",  # docs/releasing.md: a branch of a release; tests/test_docs.py builds the site
    "docker ",  # docs/containers.md: tests/test_containers.py compares what is run
    "python3 -m venv .venv",  # CI's own first step, and its test command
    "ruff format navrl tests",  # tests/test_style.py
    "python -m pytest -n auto",
    "mkdocs build --strict",  # tests/test_docs.py
    "pytest tests/sim/test_parity.py --run-slow",
    "export RAY_AUTH_MODE=token",
    "ray get-auth-token --generate '>' /dev/null",
    "scp -p '~/.ray/auth_token' '<other>:.ray/auth_token'",
    "ray start --head --port=6379",
    "ray start '--address=<head>:6379'",
    "sbatch --cpus-per-task=8",
    "python tests/clients/vector_speed.py",  # minutes; tests/clients has the equality
    "g++ -std=c++17",  # tests/export compiles the program where there is a compiler
    "pip install -c constraints.txt -e '.[full,onnx]'",
    "pip install -c constraints.txt -e '.[full,bags]'",
    "pip install -c constraints.txt -e '.[full,bags,report]'",
    MINE,  # the last test
}
OWN_TESTS = {
    "extending.md",
    "maps.md",
    "own_algorithm.md",
    "own_policy.md",
    "places.md",
}  # tests of these names
# These run every night, and what needs their results; by day those of the first job are composed.
LONG = re.compile(r"navrl-(train|train-flow|evaluate|search|export|benchmark) |navrl-\w+ -m ")
LONG_IN_README = re.compile("navrl-train -m ")


def produced(command: str) -> str | None:
    """Return the folder that a command writes, if the page can name it."""
    folder = re.search(r"hydra\.(?:run|sweep)\.dir=(\S+)", command)
    sweep = re.search(r"^navrl-(\w+) .*\bsweep=(\w+)", command)
    return folder[1] if folder else f"outputs/{sweep[1]}/{sweep[2]}" if sweep else None


def needed(page: Path, command: str) -> list[str]:
    """Return the commands further up the page whose folder this one reads or continues."""
    before = list(itertools.takewhile(lambda other: other != command, pages.commands(page)))
    reads = f"{command} {produced(command)}"
    return [other for other in before if (folder := produced(other)) and folder in reads]


def is_long(page: Path, command: str) -> bool:
    """Return whether a command, or one that it needs, is left to the night."""
    long = LONG_IN_README if page.name == "README.md" else LONG
    return any(map(long.match, [command, *needed(page, command)]))


COMMANDS = [
    pytest.param(
        *(page, command),
        id=f"{page.name}-{k}",
        marks=pytest.mark.slow if is_long(page, command) else (),
    )
    for page in pages.PAGES
    if page.name not in OWN_TESTS
    for k, command in enumerate(pages.commands(page))
    if not command.startswith(tuple(OTHERS))
]
COMPOSED = [  # by day
    pytest.param(*case.values, id=case.id)
    for case in COMMANDS
    if case.marks and LONG.match(case.values[1])
]
SWEEPS = [case for case in COMMANDS if re.match(r"navrl-(train|evaluate) -m ", case.values[1])]


def shortened(command: str) -> tuple[str, tuple[str, ...]]:
    """Return a printed command with what stands in a user's place, and the words to add."""
    for printed, here in STANDS_FOR.items():
        if command == printed or (not printed.startswith("navrl-") and printed in command):
            command = command.replace(printed, here)
    name = shlex.split(command)[0]
    extra = SHORTER[name]
    if name == "navrl-train" and "resume=" in command:
        extra = ("num_threads=1", "progress_bar=false")
    if name == "navrl-play" and "recording=" in command:
        extra = ()  # drawn as it is
    if name == "navrl-benchmark" and "rows=" not in command:
        extra = (*extra, "rows=[scan]")  # tests/benchmarks has all
    if "collector.num_workers=" in command:
        extra = (*extra, "collector.num_workers=2")
    others = "plot|report|compare|publish|suites"
    if not re.search(rf" -m |hydra\.run\.dir=|resume=|^navrl-({others})", command):
        extra = (*extra, "hydra.run.dir=outputs/printed")
    if "num_processes=" in command:
        extra = tuple(word for word in extra if not word.startswith("num_threads="))
    return command, extra


def choices(command: str) -> dict[str, list[str]]:
    """Return the keys that a command sweeps over, and their values."""
    words = dict(word.split("=", 1) for word in shlex.split(command) if "=" in word)
    if "sweep" in words:
        node = OmegaConf.load(CONF_DIR / "sweep" / f"{words['sweep']}.yaml")
        words = {key: str(value) for key, value in node.hydra.sweeper.params.items()} | words
    values = {key: re.split(r",(?![^\[]*\])", value) for key, value in words.items()}
    return {key: several for key, several in values.items() if len(several) > 1}


def two_jobs(command: str) -> str:
    """Shorten a sweep to the first and the last value of its last key; check the other values."""
    for printed, here in FEWER.items():
        command = command.replace(printed, here)
    several = choices(command)
    if not several:
        return command
    program, *given = shlex.split(command)
    fixed = [word for word in given if not re.match(r"-|hydra|sweep=", word)]
    fixed = [word for word in fixed if word.partition("=")[0] not in several]
    first = {key: values[0] for key, values in several.items()}
    for key, values in several.items():
        for value in values[1:-1]:
            job = [f"{name}={chosen}" for name, chosen in (first | {key: value}).items()]
            compose(pages.config_name(program), [*fixed, *job])
    last = next(reversed(several))
    kept = {key: values[:1] for key, values in several.items()}
    kept[last] = [several[last][0], several[last][-1]]
    words = [word for word in shlex.split(command) if word.partition("=")[0] not in several]
    return shlex.join([*words, *(f"{key}={','.join(values)}" for key, values in kept.items())])


class Bench:
    """Runs each command once per session in a user's folder of its own."""

    def __init__(self, once, monkeypatch, capsys):
        self._once, self._monkeypatch, self._capsys = once, monkeypatch, capsys

    def run(self, command: str, extra: tuple[str, ...], before: list[Path], drawn: bool) -> Path:
        """Run a command after others; return its folder, with what it said in a file beside it.

        Args:
            command: The command.
            extra: More words, see :func:`pages.run`.
            before: Folders of the commands that ran before; a training is always there.
            drawn: Whether a training draws its pictures.
        """
        words = [*pages.arguments(command, extra), *map(str, before), str(drawn)]
        name = hashlib.sha256("\n".join(words).encode()).hexdigest()[:16]
        before = before or [self._once("trained", self._train) / "user"]
        drawing = nullcontext if drawn or not command.startswith("navrl-train") else pages.undrawn

        def fill(folder):
            with drawing():
                self._run(folder, command, extra, before)

        return self._once(name, fill) / "user"

    def _train(self, folder: Path) -> None:
        (folder / "user").mkdir()
        self._monkeypatch.chdir(folder / "user")
        pages.run("navrl-train", *SHORTER["navrl-train"], f"hydra.run.dir={RUN}")
        driven(folder / "user", "ros1", duration_s=2.0)  # drive.bag

    def _run(self, folder, command, extra, before):
        for state in before:
            shutil.copytree(state, folder / "user", dirs_exist_ok=True)
        self._monkeypatch.chdir(folder / "user")
        self._capsys.readouterr()
        status = pages.exit_status(command, *extra)
        said = self._capsys.readouterr()
        (folder / "said.json").write_text(json.dumps([status, said.out, said.err]))


@pytest.fixture
def bench(once, monkeypatch, capsys):
    return Bench(once, monkeypatch, capsys)


def executed(bench: Bench, page: Path, command: str, whole: bool = False) -> Path:
    """Run a printed command after those it needs; return its folder."""
    before = [executed(bench, page, other, whole) for other in needed(page, command)]
    small, extra = shortened(command)
    if not whole and re.match(r"navrl-(train|evaluate) -m ", small):
        small = two_jobs(small)
    return bench.run(small, extra, before, drawn=whole)


def check(bench: Bench, page: Path, command: str, whole: bool = False) -> None:
    """Run a command; it ends well, or in one line where what it needs is missing."""
    lacking = [there for word, there in NEEDS.items() if word in command]
    folder = executed(bench, page, command, whole)
    status, _, said = json.loads((folder.parent / "said.json").read_text())
    if lacking and status:
        assert said.startswith("navrl: ") and lacking[0] in said.lower(), said
        assert len(said.strip().splitlines()) == 1
    else:
        assert not status, f"{command}: {said[-2000:]}"


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_printed_command_runs(page, command, bench, capsys):
    assert shlex.split(command)[0] in SHORTER, command
    if not any(word in command for word in ELSEWHERE):
        return check(bench, page, command)
    pages.run(shlex.join(first_job(command)), "--cfg", "job")
    assert "collector:" in capsys.readouterr().out


def first_job(command: str) -> list[str]:
    """Return the words of a command, of a sweep's first job."""
    several = choices(command) if " -m " in command else {}
    first = {key: values[0] for key, values in several.items()}
    words = [word for word in shlex.split(command) if not re.match(r"-m$|hydra/|hydra\.l", word)]
    words = [word for word in words if word.partition("=")[0] not in first]
    return [*words, *(f"{key}={value}" for key, value in first.items())]


@pytest.mark.parametrize(("page", "command"), COMPOSED)
def test_printed_command_has_a_configuration(page, command):
    program, *words = first_job(shortened(command)[0])
    if any(word.startswith("-") for word in words):
        return pages.run(shlex.join([program, *words]), "--cfg", "job")
    assert compose(pages.config_name(program), words)


@pytest.mark.slow
@pytest.mark.parametrize(("page", "command"), SWEEPS)
def test_all_jobs_of_printed_sweep_run(page, command, bench):
    if not any(word in command for word in ELSEWHERE):
        check(bench, page, command, whole=True)


def test_users_config_folder_needs_no_edit(tmp_path, monkeypatch):
    page = pages.ROOT / "docs" / "configuration.md"
    assert MINE in pages.commands(page)
    monkeypatch.chdir(tmp_path)
    for name, text in pages.files(page).items():
        Path(name).parent.mkdir(parents=True)
        Path(name).write_text(text)
    Path("my_package.py").write_text(
        "from torchrl.envs import Transform\n\n\nclass Jitter(Transform):\n    pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_package", raising=False)  # other tests have one too
    try:
        pages.run(MINE, *SHORTER["navrl-train"], "hydra.run.dir=mine")
    finally:
        sys.modules.pop("my_package", None)
    assert "_target_: my_package.Jitter" in Path("mine/config.yaml").read_text()
