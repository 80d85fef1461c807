"""Parser of the commands that take arguments instead of overrides."""

from __future__ import annotations

import argparse
import sys
from typing import NoReturn

from navrl import __version__


class CommandParser(argparse.ArgumentParser):
    """Parser whose help begins with the command's purpose and whose errors are one line.

    Args:
        name: Name of the command.
        about: Its purpose, one sentence without a period.
        example: A command line.
    """

    def __init__(self, name: str, about: str, example: str) -> None:
        """Make the parser with ``--help`` and ``--version``."""
        super().__init__(
            name,
            description=f"{name}: {about}",
            epilog=f"Example:\n  {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        self.add_argument(
            "--version",
            action="version",
            version=f"navrl {__version__}",
            help="show the version of navrl",
        )

    def format_help(self) -> str:
        """Return the help, the description before the usage."""
        usage, _, rest = super().format_help().partition(f"{self.description}\n\n")
        return f"{self.description}\n\n{usage}{rest}"

    def error(self, message: str) -> NoReturn:
        """Report a user's mistake in one line and exit with status 2."""
        print(f"navrl: {message}; {self.prog} --help lists the arguments", file=sys.stderr)
        sys.exit(2)
