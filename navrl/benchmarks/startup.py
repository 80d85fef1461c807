"""CPU time of commands that simulate nothing, compared with importing torch."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import navrl
from navrl.benchmarks.results import Row, at_most

_TORCH = ("-c", "import torch")
COMMANDS = {
    "help": ("navrl-evaluate --help", ("-m", "navrl.cli.evaluate", "--help")),
    "override": (
        "a wrong override of navrl-evaluate",
        ("-m", "navrl.cli.evaluate", "num_worlds=many", "hydra.run.dir=."),
    ),
    "suites": ("navrl-suites list", ("-m", "navrl.cli.suites", "list")),
}
"""What is measured: label and arguments of Python, by name."""


def startup_rows(repeats: int) -> list[Row]:
    """Measure user and system time of new processes, alternately and in both orders.

    Args:
        repeats: Measurements of each command; one more before is not counted.
    """
    words = {"torch": _TORCH} | {name: command for name, (_, command) in COMMANDS.items()}
    seconds: dict[str, list[float]] = {name: [] for name in words}
    order = list(words)
    for repeat in range(repeats + 1):
        for name in order:
            took = _cpu_seconds(words[name])
            if repeat > 0:  # the first compiles to bytecode and reads from the disk
                seconds[name].append(took)
        order.reverse()
    slowest = np.max([seconds[name] for name in COMMANDS], axis=0)
    ratio = slowest / np.array(seconds["torch"])
    label = "start-up, CPU time: import torch"
    return [
        Row("startup.torch", label, "s", seconds["torch"]),
        *(
            Row(f"startup.{name}", f"… {COMMANDS[name][0]}", "s", seconds[name])
            for name in COMMANDS
        ),
        Row("startup.ratio", "… the slowest / import torch", "x", ratio, at_most(0.5)),
    ]


def _cpu_seconds(arguments: tuple[str, ...]) -> float:
    """Return user and system time of a Python process, s."""
    package = str(Path(navrl.__file__).parents[1])
    path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, *arguments],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=False,  # a wrong override ends with status 2
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
