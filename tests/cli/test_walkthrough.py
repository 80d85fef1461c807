"""The commands of docs/reports.md do what the page says, one after the other, in one folder."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "reports.md"
SMALL = {
    "train": [
        *("num_worlds=2", "num_threads=1", "pool_size=2", "scenario=corridor"),
        *("replay.batch_size=4", "replay.capacity=200", "behavior.random_frames=4"),
        *("validation.num_episodes=2", "environment.time_limit_steps=6", "progress_bar=false"),
        *("schedule.total_frames=16", "schedule.learning_starts=4", "suite=smoke"),
        *("schedule.frames_per_update=4", "suite.num_episodes=2"),
    ],
    "evaluate": [
        *("suite=smoke", "suite.num_episodes=3", "num_worlds=3", "num_threads=1"),
        *("environment.time_limit_steps=20", "progress_bar=false"),
    ],
    "play": ["num_threads=1"],
}


def printed_commands():
    """Return the page's commands, those that make files before those that draw them."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(), re.S)
    lines = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    return sorted(filter(None, lines), key=lambda words: words[0] in ("navrl-plot", "navrl-report"))


def made_small(words):
    """Return a command with little to do, on folders that were made before."""
    name = words[0].removeprefix("navrl-")
    own = outputs_of_before(words[1:])
    small = SMALL.get(name, [])
    keys = {word.partition("=")[0] for word in small}
    kept = [word for word in own if word.partition("=")[0] not in keys]
    return [sys.executable, "-m", f"navrl.cli.{name}", *kept, *small]


def outputs_of_before(words):
    run = r"outputs/train/\d{4}-\d\d-\d\d_[\d-]+"
    return [re.sub(run, "outputs/train/ablation/paper_seed_0", word) for word in words]


@pytest.mark.slow
def test_all_commands_of_the_walkthrough_run(tmp_path):
    pytest.importorskip("plotly", reason="needs the extra report")
    if shutil.which("ffmpeg") is None:
        pytest.skip("needs the program ffmpeg")
    for words in printed_commands():
        result = subprocess.run(
            made_small(words), cwd=tmp_path, capture_output=True, text=True, timeout=1800
        )
        if "picture=rerun" in words and find_spec("rerun") is None:
            assert result.returncode == 2 and "pip install -e '.[rerun]'" in result.stderr
            continue
        assert result.returncode == 0, (words, result.stderr[-3000:])
        assert "Callback" not in result.stderr, (words, result.stderr[-3000:])
    jobs = {folder.name for folder in (tmp_path / "outputs/train/ablation").glob("*_seed_*")}
    names = ("paper", "no_spatial", "no_temporal", "no_tagd")
    assert jobs == {f"{name}_seed_{seed}" for name in names for seed in range(3)}
    (both,) = [
        tables
        for file in (tmp_path / "outputs/evaluate").glob("*/comparison.json")
        if len(tables := json.loads(file.read_text())) == 2
    ]
    assert {table["simulator"] for table in both} == {"BatchedSimulator", "BulletSimulator"}
    for name in ("tagd", "strip", "failures", "attention", "rates"):
        assert list((tmp_path / "outputs/plot").glob(f"*/{name}.svg")), name
    assert (tmp_path / "curves.pdf").is_file()
    assert (tmp_path / "report.html").is_file()
    assert (tmp_path / "outputs/train/ablation/report.html").is_file()
