"""Help and version of each command."""

import importlib
import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from nightly import mostly
from pages import config_name

from navrl import __version__
from navrl.config import CONF_DIR, check_types, compose

ROOT = Path(__file__).parents[2]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
COMMANDS = sorted(name.removeprefix("navrl-") for name in SCRIPTS)
CONFIGURED = [name for name in COMMANDS if (CONF_DIR / f"{config_name(name)}.yaml").is_file()]


def shown(command, word, monkeypatch, capsys):
    """Return what ``navrl-COMMAND WORD`` prints; it must end with status 0."""
    monkeypatch.setattr(sys, "argv", [f"navrl-{command}", word])
    status = 0
    try:
        status = importlib.import_module(f"navrl.cli.{config_name(command)}").main()
    except SystemExit as end:
        status = end.code
    assert not status
    return capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_opens_with_purpose_and_ends_with_example(command, monkeypatch, capsys):
    lines = shown(command, "--help", monkeypatch, capsys).strip().splitlines()
    assert lines[0].startswith(f"navrl-{command}") and ": " in lines[0]
    assert lines[-2] == "Example:" and lines[-1].startswith(f"  navrl-{command} ")


@pytest.mark.parametrize("command", CONFIGURED)
def test_help_lists_own_keys_with_comments(command, monkeypatch, capsys):
    lines = [line.strip() for line in shown(command, "-h", monkeypatch, capsys).splitlines()]
    plain = yaml.safe_load((CONF_DIR / f"{config_name(command)}.yaml").read_text())
    keys = set(plain) - {"defaults", "hydra"}
    listed = lines[lines.index("Keys, KEY=VALUE:") + 1 :]
    listed = [line for line in listed[: listed.index("")] if "=" in line.partition("  ")[0]]
    found = {line.partition("=")[0].partition(".")[0] for line in listed}
    assert keys <= found
    for key in keys:
        (first, *_) = (k for k, line in enumerate(lines) if line.startswith((f"{key}=", f"{key}.")))
        assert "  " in lines[first] or lines[first + 1], key  # the comment, perhaps a line below
    groups = [entry for entry in plain["defaults"] if isinstance(entry, dict)]
    names = (next(iter(entry)).removeprefix("override ").removeprefix("/") for entry in groups)
    for group in names:
        assert group.startswith("hydra/") or any(x.startswith(f"{group}=") for x in lines), group


@pytest.mark.parametrize("command", ["train", "evaluate", "play"])
def test_help_lists_inherited_groups_and_keys(command, monkeypatch, capsys):
    text = shown(command, "--help", monkeypatch, capsys)
    listed = set(re.findall(r"^  ([\w@]+)[=.]", text, re.MULTILINE))
    listed |= {name.partition("@")[2] for name in listed if "@" in name}
    assert set(compose(command)) <= listed
    assert "speed_corridor" in text  # a member of a family


@pytest.mark.parametrize(
    "command, line",
    [
        (
            "evaluate",
            "latency=0                       episodes replayed one at a time on one thread",
        ),
        (
            "evaluate",
            "sweep=null                      density, elsewhere, robustness, scanners, speed",
        ),
        ("train", "sweep=null                      ablation, baselines, seeds"),
        ("train", "validation.seed=1_000_003       seed of its scenarios"),
        ("train", "hydra.run.dir=FOLDER            folder of the results; outputs/train/TIME if"),
        ("train", "logger=[tensorboard]            "),
        ("plot", "source=???                      required; folder or file"),
        ("benchmark", "effort=standard                 quick, standard"),
    ],
)
def test_help_shows_default_and_comment(command, line, monkeypatch, capsys):
    assert f"  {line}" in shown(command, "--help", monkeypatch, capsys)


def test_help_lists_a_changed_default_once(monkeypatch, capsys):
    lines = shown("train-flow", "--help", monkeypatch, capsys).splitlines()
    changed = [line for line in lines if line.startswith(("  policy=", "  pedestrians="))]
    assert [line.split()[0] for line in changed] == [
        "pedestrians=mostly_scripted",
        "policy=navrl-best-places",
    ]


@pytest.mark.parametrize("command", CONFIGURED)
def test_help_omits_keys_of_other_commands(command, monkeypatch, capsys):
    text = shown(command, "--help", monkeypatch, capsys)
    assert "ablation" not in text or command == "train"
    assert "zoo  " not in text or command in (
        "doctor",
        "evaluate",
        "export",
        "play",
        "replay",
        "train-flow",
    )
    assert "callbacks" not in text and "override_dirname" not in text


@pytest.mark.parametrize("command", mostly(CONFIGURED, ["train", "evaluate", "play"]))
def test_example_of_help_is_a_valid_command(command, monkeypatch, capsys):
    words = shlex.split(shown(command, "--help", monkeypatch, capsys).splitlines()[-1])[1:]
    overrides = [word for word in words if "=" in word]
    check_types(config_name(command), overrides)
    assert compose(config_name(command), overrides)


@pytest.mark.parametrize("command", COMMANDS)
def test_version_is_that_of_navrl(command, monkeypatch, capsys):
    assert shown(command, "--version", monkeypatch, capsys) == f"navrl {__version__}\n"


@pytest.mark.parametrize("command", ["publish", "report", "suites"])
def test_wrong_arguments_are_one_error_line(command, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [f"navrl-{command}", "--nothing"])
    with pytest.raises(SystemExit) as end:
        importlib.import_module(f"navrl.cli.{command}").main()
    lines = capsys.readouterr().err.splitlines()
    assert end.value.code == 2 and len(lines) == 1 and lines[0].startswith("navrl: ")
