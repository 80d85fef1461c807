"""``navrl-report``: gather runs, evaluations and episodes into one HTML page."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from navrl.cli.arguments import CommandParser
from navrl.config import describe


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the page and say where it is; what a user gets wrong ends in one line, status 2."""
    options = make_parser().parse_args(arguments)
    out = options.out or Path(options.folders[0]) / "report.html"
    from navrl.viz.report import write_report  # imports torch and matplotlib

    try:
        file = write_report(options.folders, out, options.reference, options.episodes)
    except (ImportError, OSError, ValueError) as error:
        line = str(error) if isinstance(error, ImportError) else describe(error)
        print(f"navrl: {line}", file=sys.stderr)
        sys.exit(2)
    print(f"{file}: {file.stat().st_size / 1e6:.1f} MB, opens in any browser, needs no network")


def make_parser() -> CommandParser:
    """Return the parser of the command line."""
    about = "gather runs, evaluations and episodes into one HTML page"
    parser = CommandParser("navrl-report", about, "navrl-report outputs --out report.html")
    parser.add_argument("folders", nargs="+", metavar="FOLDER", help="everything below it counts")
    parser.add_argument(
        "--out", type=Path, help="the page; report.html in the first folder if not given"
    )
    parser.add_argument(
        "--reference",
        help="policy that others are compared with; if not given, paper, else the best that "
        "does not read the true state",
    )
    parser.add_argument(
        "--episodes", type=int, default=12, help="recorded episodes to put in, lost ones first"
    )
    return parser


if __name__ == "__main__":
    main()
