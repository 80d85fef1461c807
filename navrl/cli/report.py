"""``navrl-report``: write one HTML page of runs, evaluations and episodes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from navrl.cli.arguments import CommandParser
from navrl.config import describe


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the page and print its path; user errors exit with one line and status 2."""
    options = make_parser().parse_intermixed_args(arguments)
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
        "--out", type=Path, help="file of the page; default: report.html in the first folder"
    )
    parser.add_argument(
        "--reference",
        help="policy that others are compared with; default: paper, or the best that is not "
        "privileged",
    )
    parser.add_argument(
        "--episodes", type=int, default=12, help="maximum number of recorded episodes, failed first"
    )
    return parser


if __name__ == "__main__":
    main()
