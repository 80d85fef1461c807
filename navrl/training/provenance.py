"""Provenance of a run: its commands, code versions and machines."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import torch

import navrl
from navrl.untrusted import read_text

_FILE = "commands.txt"
_PACKAGES = ("torch", "torchrl", "tensordict", "numpy")  # their versions may change numbers


def record_command(folder: Path) -> None:
    """Append command, code version and machine of this process to the history of a run."""
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    with (folder / _FILE).open("a", encoding="utf-8") as history:
        history.write(f"{command}  # {now}, navrl {code_version()}, {_machine()}\n")


def recorded_commands(folder: Path) -> str:
    """Return the history of :func:`record_command`, oldest first; empty if there is none."""
    file = folder / _FILE
    return read_text(file, "delete it") if file.is_file() else ""


def recorded_origins(folder: Path) -> list[str]:
    """Return time, code version and machine of each recorded command, oldest first."""
    lines = recorded_commands(folder).splitlines()
    return [line.rpartition("  # ")[2] for line in lines if "  # " in line]


def code_version() -> str:
    """Return the version, with the commit in a git checkout."""
    root = Path(navrl.__file__).parents[1]
    if not (root / ".git").exists():
        return navrl.__version__
    try:
        commit = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty"],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return navrl.__version__
    return f"{navrl.__version__} at commit {commit}"


def _machine() -> str:
    gpu = f", {torch.cuda.get_device_name()}" if torch.cuda.is_available() else ""
    packages = ", ".join(f"{name} {version(name)}" for name in _PACKAGES)
    python = platform.python_version()
    return f"{platform.machine()}, {os.cpu_count()} cores{gpu}, Python {python}, {packages}"
