"""``navrl-suites``: list, check and freeze suites of episodes."""

from __future__ import annotations

import argparse
import os
import sys

from navrl.config import describe
from navrl.jobs.suites import check_frozen, freeze, frozen_suites
from navrl.worlds import FrozenSuiteError, frozen_episodes


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit status.

    Args:
        arguments: Command-line arguments; those of this process if ``None``.
    """
    parser = argparse.ArgumentParser("navrl-suites", description=__doc__.splitlines()[0])
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
    options = parser.parse_args(arguments)
    try:
        entries = frozen_suites(options.names)
        return max([_act(options.action, entry, options.num_workers) for entry in entries])
    except (OSError, ValueError) as error:
        print(f"navrl: {describe(error)}", file=sys.stderr)
        return 2


def _act(action: str, entry, num_workers: int) -> int:
    """Process one suite; return 1 if it differs from the frozen one."""
    suite, told = entry.suite, ""
    try:
        if action == "check":
            check_frozen(entry, num_workers)
            told = "unchanged"
        elif action == "freeze":
            told = "frozen" if freeze(entry, num_workers) else "unchanged"
        digest = frozen_episodes(suite.name, suite.version).sha256[suite.num_episodes]
    except FrozenSuiteError as error:
        print(f"navrl: {error}", file=sys.stderr)
        return 1
    words = " ".join(entry.overrides)
    print(f"{suite.name:24} v{suite.version} {suite.num_episodes:5} {digest[:16]} {told:9} {words}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
