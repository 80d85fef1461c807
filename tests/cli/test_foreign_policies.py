"""Policies from outside navrl play, are evaluated and are compared like any other."""

import json
import sys
import textwrap
from pathlib import Path

import pages
import pytest

TINY = ["suite=smoke", "suite.num_episodes=3", "num_worlds=3", "num_threads=1"]
TINY += ["environment.time_limit_steps=4", "progress_bar=false"]
FILES = {
    "own_policies.py": """
        import torch

        def ahead(tensordict):
            return tensordict.set("action", torch.zeros(*tensordict.batch_size, 2))
    """,
    "remote.py": """
        import json, sys
        for line in sys.stdin:
            message = json.loads(line)
            if message["type"] == "hello":
                print(json.dumps({"observes": ["pose"]}), flush=True)
            elif message["type"] == "step":
                action = [[0.5, 0.0] for _ in message["observations"]["pose"]]
                print(json.dumps({"action": action}), flush=True)
    """,
    "lost.py": "import sys\nsys.stdin.readline()\nprint('{\"observes\": []}')",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name, text in FILES.items():
        Path(name).write_text(textwrap.dedent(text))
    yield tmp_path
    sys.modules.pop("own_policies", None)


def evaluate(policy, folder, *more):
    words = [f"policy={policy}", *TINY, f"hydra.run.dir={folder}", *more]
    pages.run("navrl-evaluate", *words)
    return json.loads(Path(folder, "summary.json").read_text())


@pytest.mark.slow
def test_callable_and_process_are_in_one_table(here, capsys):
    command = f"process:{sys.executable} remote.py"
    called = evaluate("own_policies:ahead", "called")
    remote = evaluate(command, "remote", "num_processes=2", "num_worlds=2")
    assert called["policy"] == "ahead" and remote["policy"] == "remote"
    assert called["observes"] == ["scan", "pose", "path", "odometry"]
    assert remote["observes"] == ["pose"] and remote["errors"] == 0
    pages.run("navrl-compare", "called", "remote", "out=tables")
    table = capsys.readouterr().out
    assert (
        "What each policy may read. scan, pose, path, odometry: `ahead`; pose: `remote`." in table
    )
    assert '"scan, pose, path, odometry"' in Path("tables/comparison.csv").read_text()
    # Both drive at half speed straight ahead.
    rows = [Path(name, "episodes.csv").read_text() for name in ("called", "remote")]
    assert rows[0] == rows[1]


@pytest.mark.slow
def test_changed_program_is_evaluated_again(here, capsys):
    command = f"process:{sys.executable} remote.py"
    first = evaluate(command, "run")
    capsys.readouterr()
    evaluate(command, "run")
    assert "finished before" in capsys.readouterr().out
    text = Path("remote.py").read_text()
    Path("remote.py").write_text(text.replace("[0.5, 0.0]", "[0.0, 0.0]"))
    second = evaluate(command, "run")
    assert second["policy_hash"] != first["policy_hash"]


@pytest.mark.slow
def test_changed_module_is_evaluated_again(here):
    hashes = []
    for _ in range(2):
        hashes.append(evaluate("own_policies:ahead", "run")["code_hash"])
        with Path("own_policies.py").open("a") as file:
            file.write("# changed\n")
    assert hashes[0] != hashes[1]


def test_ended_process_is_reported_in_one_line(here, capsys):
    status = pages.exit_status(
        "navrl-evaluate", f"policy=process:{sys.executable} lost.py", *TINY, "hydra.run.dir=run"
    )
    (line,) = [one for one in capsys.readouterr().err.splitlines() if one.startswith("navrl: ")]
    assert status == 2
    assert line.startswith("navrl: policy ") and "lost.py: the process ended" in line


def test_untrusted_zip_ends_in_one_line(here, capsys):
    Path("ppo.zip").write_bytes(b"PK")
    status = pages.exit_status("navrl-evaluate", "policy=ppo.zip", *TINY, "hydra.run.dir=run")
    error = capsys.readouterr().err
    assert status == 2 and "set trusted=true" in error


def test_callable_is_played_and_drawn(here):
    pages.run(
        "navrl-play",
        *("policy=own_policies:ahead", "suite=smoke", "num_threads=1", "hydra.run.dir=play"),
        "environment.time_limit_steps=3",
    )
    assert Path("play/episode.gif").stat().st_size > 1000
