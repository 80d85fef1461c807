"""Metadata hook of the build: a README whose pictures and links work outside the repository."""

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

VARIABLE = "NAVRL_REPOSITORY_URL"
_RELATIVE = r"(?!\w+:|#|//)"
_LINK = re.compile(rf"""(!?)\[([^\]]*)\]\({_RELATIVE}([^)\s]+)(\s+"[^"]*")?\)""")
_OTHER_FORM = re.compile(
    rf"""<img\b[^>]*\bsrc=["']?{_RELATIVE}\w[^>]*>|^\s*\[[^\]]+\]:\s*{_RELATIVE}\S+"""
    rf"|\]\({_RELATIVE}[^)]*\)",
    re.MULTILINE,
)


def repository_address(environment: Mapping[str, str], urls: Mapping[str, str]) -> str:
    """Return the address of the repository, empty if there is none.

    Args:
        environment: Environment variables; ``NAVRL_REPOSITORY_URL`` takes precedence.
        urls: ``[project.urls]``, of which ``Repository`` is read.

    Raises:
        ValueError: If the address is not one of a web page.

    Example:
        >>> repository_address({}, {"Repository": "https://example.org/navrl/"})
        'https://example.org/navrl'
    """
    address = environment.get(VARIABLE) or urls.get("Repository", "")
    if address and not re.fullmatch(r"https?://[^\s/?#]+/[^\s?#]*[^\s?#/]/?", address):
        raise ValueError(
            f"{VARIABLE}={address}: must be the web address of the repository, such as "
            "https://github.com/OWNER/NAME"
        )
    return address.rstrip("/")


def absolute_links(text: str, repository: str, version: str) -> str:
    """Return Markdown with absolute addresses in place of relative ones.

    Args:
        text: Markdown with pictures and links relative to the root of the repository.
        repository: Address of the repository, e.g. ``https://github.com/OWNER/NAME``; if empty,
            pictures are left out and links become their text.
        version: Version of the release, whose tag is ``v<version>``.

    Raises:
        ValueError: If the text has a relative picture or link of another form, which is not
            replaced: the HTML tag ``img``, a Markdown reference or a picture within a link.

    Example:
        >>> absolute_links("[Results](docs/results.md)", "https://example.org/navrl", "1.0")
        '[Results](https://example.org/navrl/blob/v1.0/docs/results.md)'
    """

    def replaced(match: re.Match[str]) -> str:
        mark, shown, path, title = match.groups(default="")
        if not repository:
            return "" if mark else shown
        kind = "raw" if mark else "blob"
        return f"{mark}[{shown}]({repository}/{kind}/v{version}/{path.removeprefix('./')}{title})"

    result = _LINK.sub(replaced, text)
    other = _OTHER_FORM.search(result)
    if other is not None:
        raise ValueError(f"{other[0].strip()}: must be written as [text](path) or ![text](path)")
    return result


class CustomMetadataHook(MetadataHookInterface):
    """Set the long description of the package from README.md."""

    def update(self, metadata: dict) -> None:
        """Add ``readme`` to the project's metadata."""
        root = Path(self.root)
        source = (root / "navrl" / "__init__.py").read_text()
        (version,) = re.findall(r'^__version__ = "([^"]+)"', source, re.M)
        repository = repository_address(os.environ, metadata.get("urls", {}))
        if not repository:
            print(
                f"navrl: {VARIABLE} is not set: the package's description has no pictures and no "
                "links to pages of the repository",
                file=sys.stderr,
            )
        shown = absolute_links((root / "README.md").read_text(), repository, version)
        metadata["readme"] = {"content-type": "text/markdown", "text": shown}
