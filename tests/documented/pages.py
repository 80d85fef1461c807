"""What the documentation prints: code blocks, files and shell commands; and how to run it here."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from unittest import mock

from navrl import viz

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
SHELLS = ("sh", "bash", "console", "")  # a block without a language is a command too

TINY_TRAINING = (
    *("num_worlds=2", "num_threads=1", "pool_size=2", "replay.batch_size=4"),
    *("replay.capacity=100", "behavior.random_frames=4", "validation.num_episodes=2"),
    *("environment.time_limit_steps=4", "schedule.total_frames=16", "schedule.learning_starts=4"),
    *(
        "schedule.frames_per_update=4",
        "schedule.log_every_updates=1",
        "suite.num_episodes=2",
        "progress_bar=false",
    ),
)


def fences(page: Path) -> list[tuple[str, str]]:
    """Return each fenced block of a page: what stands behind its fence, and its text."""
    parts = re.split(r"^```(.*)\n", page.read_text(), flags=re.M)
    return list(zip(parts[1::4], parts[2::4], strict=True))


def blocks(page: Path, language: str) -> list[str]:
    """Return the code blocks of a language that carry no title."""
    return [text for info, text in fences(page) if info == language]


def files(page: Path) -> dict[str, str]:
    """Return what a page wants in files: the blocks whose title is a path."""
    titles = [(re.search(r'title="([^"]+)"', info), text) for info, text in fences(page)]
    found = [(title[1], text) for title, text in titles if title]
    assert len(dict(found)) == len(found), f"{page.name}: a file is printed twice"
    return dict(found)


def commands(page: Path) -> list[str]:
    """Return the page's shell commands, each in one line, without prompt and comment.

    They are in blocks, or within the text if they have at least one argument.
    """
    text = re.sub(r"(?ms)^```.*?^```", "", page.read_text())
    lines = re.findall(r"`(navrl-[a-z-]+ [^`]+)`", text)
    for language in SHELLS:
        for block in blocks(page, language):
            text = re.sub(r"\\\n\s*", " ", block)
            lines += [re.sub(r"^(\w*)\$ +", "", line) for line in text.splitlines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [shlex.join(line) for line in words if line]


def run(command: str, *extra: str) -> object:
    """Run one of our commands in this process, as its installed script would.

    A process of its own would spend most of its time on importing torch.

    Args:
        command: As printed; ``NAME=VALUE`` before it is the caller's business.
        extra: More words; one that sets what the command sets already takes its place.
    """
    words = arguments(command, extra)
    module = importlib.import_module(f"navrl.cli.{config_name(words[0])}")
    with mock.patch.object(sys, "argv", words):
        return module.main()


def config_name(program: str) -> str:
    """Return the name of a command's configuration and module."""
    return program.removeprefix("navrl-").replace("-", "_")


def undrawn() -> AbstractContextManager:
    """Let trainings write empty pictures, where others of the same kind draw them."""
    functions = ("plot_curves", "save_gif", "save_png")
    empty = dict.fromkeys(functions, lambda _, file, **__: file.touch())
    return mock.patch.multiple(viz, **empty)


def exit_status(command: str, *extra: str) -> int:
    """Run one of our commands as :func:`run` does; return the exit status of its process."""
    try:
        run(command, *extra)
    except SystemExit as end:
        return end.code or 0
    return 0


def arguments(command: str, extra: Sequence[str]) -> list[str]:
    """Return what :func:`run` gives a command as ``sys.argv``."""
    words = shlex.split(command)
    start = next(k for k, word in enumerate(words) if word.startswith("navrl-"))
    keys = {word.lstrip("+").partition("=")[0] for word in extra if "=" in word}
    kept = [word for word in words[start:] if word.lstrip("+").partition("=")[0] not in keys]
    return [*kept, *extra]
