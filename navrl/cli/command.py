"""Make a command of a function that takes a config."""

from __future__ import annotations

import functools
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from navrl import __version__
from navrl.cli.help import help_text
from navrl.config import CONF_DIR, USER_ERRORS, check_types, describe, nearest_names
from navrl.deprecated_groups import check_groups, renamed_overrides


def hydra_main(
    config_name: str, argument: str | None = None
) -> Callable[[Callable[[DictConfig], Any]], Callable[[], Any]]:
    """Make a command of a function that takes a config.

    What a user can get wrong (an override, a range, a file) ends in one line on stderr and exit
    status 2; a programming error keeps its traceback. ``NAVRL_TRACEBACK=1`` shows it in any case.
    ``--help`` and ``--version`` are answered before anything is composed.

    Args:
        config_name: The command's primary config.
        argument: Key that a first word without a key sets, e.g. ``bag`` in ``navrl-replay BAG``.
    """

    def decorate(task: Callable[[DictConfig], Any]) -> Callable[[], Any]:
        @functools.wraps(task)
        def checked(cfg: DictConfig) -> Any:
            with _ErrorLine():
                check_groups(cfg)
                check_types(config_name, HydraConfig.get().overrides.task, cfg)
                return task(cfg)

        run = hydra.main(version_base="1.3", config_path=str(CONF_DIR), config_name=config_name)

        @functools.wraps(task)
        def main() -> None:
            os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors reach us, not a printed page
            sys.argv[1:] = renamed_overrides(_with_key(sys.argv[1:], argument))
            with _ErrorLine(config_name):
                if not _is_help_shown(config_name, sys.argv[1:]):
                    run(checked)()

        return main

    return decorate


@contextmanager
def missing_extras() -> Iterator[None]:
    """Report a package that the block needs and that is not installed as a user's mistake.

    Raises:
        ValueError: If the block raises ImportError, whose message names the extra.
    """
    try:
        yield
    except ImportError as missing:
        raise ValueError(str(missing)) from missing


def _with_key(words: list[str], key: str | None) -> list[str]:
    """Return the words with the key of a first word that has none, quoted for Hydra."""
    if key is None or not words or "=" in words[0] or words[0][:1] in ("-", "+", "~", ""):
        return words
    quoted = words[0].replace("\\", "\\\\").replace("'", "\\'")
    return [f"{key}='{quoted}'", *words[1:]]


def _is_help_shown(config_name: str, words: list[str]) -> bool:
    """Print help or version if the command line asks for it; return whether it did."""
    if "--help" in words or "-h" in words:
        print(help_text(config_name))
    elif "--version" in words:
        print(f"navrl {__version__}")
    else:
        return False
    return True


class _ErrorLine:
    """Report a user's mistake in one line."""

    def __init__(self, config_name: str | None = None) -> None:
        self._config_name = config_name

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, KeyboardInterrupt):
            print("navrl: interrupted", file=sys.stderr)
            sys.exit(128 + signal.SIGINT)
        if not isinstance(error, USER_ERRORS) or os.environ.get("NAVRL_TRACEBACK"):
            return
        line = describe(error)
        if self._config_name is not None:
            hint = nearest_names(line, self._config_name)
            line = line.removesuffix(".") + hint if hint else line
        print(f"navrl: {line}", file=sys.stderr)
        sys.exit(2)
