"""Every command that README and docs print does what it says, on fewer and shorter episodes."""

import os
import re
import shlex
import sys
from pathlib import Path

import pages
import pytest

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
    "navrl-report": (),
    "navrl-suites": (),
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
    "navrl-evaluate -m policy=all": "navrl-evaluate -m policy=stand_still,dwa",
    "policy=FOLDER": "policy=paper",
    "policy=PATH": "policy=paper",
    "000017.npz": "000001.npz",
    "sweep=density policy=all": "sweep=density policy=stand_still",
    "sweep=density policy=navrl-best,paper": "sweep=density policy=stand_still",
    "sweep=speed policy=navrl-best,paper": "sweep=speed policy=stand_still",
    "policy=all simulator=bullet": "policy=paper,dwa simulator=bullet",
    "navrl-suites check table1": "navrl-suites check validation",
    "navrl-suites freeze": "navrl-suites freeze validation",
}
# Several machines, a scheduler or a service that a test has not: what they choose is composed.
ELSEWHERE = ("address=auto", "submitit", "slurm", "launcher=ray_cluster", "collector=ray")
# What may be missing here, hardware or an optional dependency, which must be told in a line.
NEEDS = {
    **{"device=cuda": "cuda", "hardware=gpu": "cuda", "rows=[gpu]": "cuda"},
    **{"gui=true": "display", "mp4": "ffmpeg", "picture=rerun": "rerun"},
    **{"navrl-report": "plotly", "launcher=cores": "joblib"},
}
# Run by CI itself, or no command of ours: exactly these.
OTHERS = {
    "python -m build",  # docs/releasing.md: tests/test_packaging.py builds and lists the wheel
    "python -m zipfile",
    "python -m pytest --run-slow",
    "python3 -m venv smoke",
    "bin/",
    "git tag",
    "git push",
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
    MINE,  # the last test
}
OWN_TESTS = {"extending.md"}  # tests/test_extending.py
PAGES = [page for page in pages.PAGES if pages.commands(page) and page.name not in OWN_TESTS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A user's folder with a training run in it."""
    folder = tmp_path_factory.mktemp("user")
    before = Path.cwd()
    os.chdir(folder)
    pages.run("navrl-train", *SHORTER["navrl-train"], f"hydra.run.dir={RUN}")
    yield folder
    os.chdir(before)


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
        # the default folder is named by the second: too coarse for what runs in less
        extra = (*extra, f"hydra.run.dir=outputs/{len(os.listdir('outputs'))}")
    if "num_processes=" in command:
        extra = tuple(word for word in extra if not word.startswith("num_threads="))
    return command, extra


def check(command: str, capsys) -> None:
    """Run a command; it ends well, or as it must on a machine without GPU or display."""
    if any(word in command for word in ELSEWHERE):
        single = re.sub(r"(?<=\s)(-m|hydra/\S+|hydra\.launcher\S+)(?=\s)", "", f"{command} ")
        single = re.sub(r"=([^\s,\[]+),\S+", r"=\1", single)  # the first of each choice
        pages.run(single, "--cfg", "job")
        assert "collector:" in capsys.readouterr().out
        return
    lacking = [there for word, there in NEEDS.items() if word in command]
    command, extra = shortened(command)
    try:
        status = pages.run(command, *extra)
    except SystemExit as end:
        status = end.code
    told = capsys.readouterr()
    if lacking and status:
        assert told.err.startswith("navrl: ") and lacking[0] in told.err.lower(), told.err
        assert len(told.err.strip().splitlines()) == 1
    else:
        assert not status, f"{command}: {told.err[-2000:]}"


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_printed_commands_run(page, folder, capsys):
    for command in pages.commands(page):
        if any(command.startswith(other) for other in OTHERS):
            continue
        assert shlex.split(command)[0] in SHORTER, command
        check(command, capsys)


def test_users_config_folder_needs_no_edit(folder, monkeypatch):
    page = pages.ROOT / "docs" / "configuration.md"
    assert MINE in pages.commands(page)
    for name, text in pages.files(page).items():
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text(text)
    (folder / "my_package.py").write_text(
        "from torchrl.envs import Transform\n\n\nclass Jitter(Transform):\n    pass\n"
    )
    monkeypatch.syspath_prepend(str(folder))
    try:
        pages.run(MINE, *SHORTER["navrl-train"], "hydra.run.dir=mine")
    finally:
        sys.modules.pop("my_package", None)  # other tests have one of this name too
    assert "_target_: my_package.Jitter" in (folder / "mine" / "config.yaml").read_text()
