"""``navrl-suites``: list, check and freeze suites of episodes."""

from __future__ import annotations

import os
import sys

from navrl.cli.arguments import CommandParser
from navrl.config import describe
from navrl.jobs.suites import FrozenSuite, check_frozen, freeze, frozen_suites
from navrl.worlds.frozen import FrozenSuiteError, frozen_episodes


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit status.

    Args:
        arguments: Command-line arguments; those of this process if ``None``.
    """
    options = make_parser().parse_intermixed_args(arguments)
    try:
        entries = frozen_suites(options.names)
        return max([_act(options.action, entry, options.num_workers) for entry in entries])
    except (OSError, ValueError) as error:
        print(f"navrl: {describe(error)}", file=sys.stderr)
        return 2


def make_parser() -> CommandParser:
    """Return the parser of the command line."""
    about = "list, check and freeze the sets of episodes that scores are reported on"
    parser = CommandParser("navrl-suites", about, "navrl-suites check validation")
    parser.add_argument(
        "action",
        nargs="?",
        default="list",
        choices=["list", "check", "freeze"],
        help="list the suites and their hashes; regenerate and compare all episodes; or freeze "
        "new suites (default: list)",
    )
    parser.add_argument("names", nargs="*", help="names of suites, as listed (default: all)")
    parser.add_argument("--num-workers", type=int, default=os.cpu_count() or 1, help="processes")
    return parser


def _act(action: str, entry: FrozenSuite, num_workers: int) -> int:
    """List, check or freeze one suite; return 1 if its episodes are not the frozen ones."""
    result = ""
    try:
        if action == "check":
            check_frozen(entry, num_workers)
            result = "unchanged"
        elif action == "freeze":
            result = "frozen" if freeze(entry, num_workers) else "unchanged"
        digest = frozen_episodes(entry.name, entry.version).sha256[entry.num_episodes]
    except FrozenSuiteError as error:
        print(f"navrl: {error}", file=sys.stderr)
        return 1
    words = " ".join(entry.overrides)
    size = f"v{entry.version} {entry.num_episodes:5}"
    print(f"{entry.name:24} {size} {digest[:16]} {result:9} {words}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
