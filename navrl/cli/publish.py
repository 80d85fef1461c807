"""``navrl-publish``: write a bundle with a model card of a run's best policy."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from navrl.cli.arguments import CommandParser
from navrl.config import describe


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the bundle and print its path; user errors exit with one line and status 2."""
    options = make_parser().parse_intermixed_args(arguments)
    from navrl.jobs.publishing import publish, publish_extended  # imports torch

    given = vars(options)
    steps = given.pop("steps")
    try:
        if steps:
            for name in ("half", "last"):
                if given.pop(name):
                    raise ValueError(f"--{name}: must not be used with --steps")
            folder = publish_extended(given.pop("run"), given.pop("out"), steps, **given)
        else:
            folder = publish(**given)
    except (OSError, ValueError) as error:
        print(f"navrl: {describe(error)}", file=sys.stderr)
        sys.exit(2)
    size = sum(file.stat().st_size for file in folder.iterdir())
    print(f"{folder}: {size / 1e6:.1f} MB; navrl-evaluate policy={folder}")


def make_parser() -> CommandParser:
    """Return the parser of the command line."""
    about = "make a bundle with a card of a run's best policy"
    example = "navrl-publish outputs/train/mine bundles/mine --about 'Trained in offices'"
    parser = CommandParser("navrl-publish", about, example)
    parser.add_argument(
        "run", type=Path, metavar="RUN", help="folder of navrl-train; with --steps a bundle"
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the bundle, named like it")
    parser.add_argument(
        "--evaluations",
        nargs="+",
        default=[],
        metavar="FOLDER",
        help="folders of navrl-evaluate with this policy, for the card; searched recursively",
    )
    parser.add_argument(
        "--steps",
        nargs="+",
        default=[],
        metavar="STEP",
        help="add these options of transforms/steps to the pipeline of a bundle",
    )
    parser.add_argument("--about", default="", help="a sentence that describes the policy")
    parser.add_argument(
        "--half", action="store_true", help="store weights as float16, in half the space"
    )
    parser.add_argument(
        "--last", action="store_true", help="the policy of the last validation, not the best one"
    )
    return parser


if __name__ == "__main__":
    main()
