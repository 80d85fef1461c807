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
    steps, is_fetched = given.pop("steps"), given.pop("fetch")
    sha256, shared = given.pop("sha256"), {k: given.pop(k) for k in ("archive", "hub", "private")}
    try:
        if is_fetched:
            if steps or any(shared.values()):
                raise ValueError("--fetch: must not be used with --steps, --archive or --hub")
            folder = _fetch(given, sha256)
        elif sha256 is not None:
            raise ValueError("--sha256: must be used with --fetch")
        elif steps:
            for name in ("half", "last"):
                if given.pop(name):
                    raise ValueError(f"--{name}: must not be used with --steps")
            folder = publish_extended(given.pop("run"), given.pop("out"), steps, **given)
        else:
            folder = publish(**{**given, "run": Path(given["run"])})
        notes = [] if is_fetched else _share(folder, **shared)
    except (OSError, ValueError) as error:
        print(f"navrl: {describe(error)}", file=sys.stderr)
        sys.exit(2)
    size = sum(file.stat().st_size for file in folder.iterdir())
    print(f"{folder}: {size / 1e6:.1f} MB; navrl-evaluate policy={folder}")
    for note in notes:
        print(note)


def _fetch(given: dict, sha256: str | None) -> Path:
    """Get a bundle; the options of publishing must not be given."""
    from navrl.jobs.sharing import fetch

    if sha256 is None:
        raise ValueError("--fetch: needs --sha256, the digest that navrl-publish printed")
    used = [name for name in ("evaluations", "about", "half", "last") if given[name]]
    if used:
        raise ValueError(f"--{used[0]}: must not be used with --fetch")
    return fetch(given["run"], given["out"], sha256)


def _share(folder: Path, archive: bool, hub: str | None, private: bool) -> list[str]:
    """Write checksums, and the archive or upload that is requested; return lines to print."""
    from navrl.jobs.sharing import upload, write_archive, write_sums

    notes, digest = [], write_sums(folder)
    if archive:
        file = write_archive(folder)
        notes.append(f"navrl-publish {file} {folder.name} --fetch --sha256 {digest}")
    if hub is not None:
        address = upload(folder, hub, private)
        notes.append(f"navrl-publish {address} {folder.name} --fetch --sha256 {digest}")
    return notes


def make_parser() -> CommandParser:
    """Return the parser of the command line."""
    about = "make a bundle with a card of a run's best policy"
    example = "navrl-publish outputs/train/mine bundles/mine --about 'Trained in offices'"
    parser = CommandParser("navrl-publish", about, example)
    parser.add_argument(
        "run",
        metavar="RUN",
        help="folder of navrl-train; with --steps a bundle; with --fetch a .tar or hf://OWNER/NAME@COMMIT",
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
    parser.add_argument(
        "--archive", action="store_true", help="write OUT.tar too, an asset of a release"
    )
    parser.add_argument(
        "--hub", metavar="OWNER/NAME", help="upload to this repository of the Hugging Face Hub"
    )
    parser.add_argument(
        "--private", action="store_true", help="a repository created by --hub is private"
    )
    parser.add_argument(
        "--fetch",
        action="store_true",
        help="get the published bundle RUN, check it, write it to OUT",
    )
    parser.add_argument("--sha256", metavar="DIGEST", help="digest of the bundle, with --fetch")
    return parser


if __name__ == "__main__":
    main()
