"""Metadata hook of the build: a README whose pictures and links work outside the repository."""

import os
import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

VARIABLE = "NAVRL_REPOSITORY_URL"
_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!\w+:|#)([^)\s]+)\)")


def absolute_links(text: str, repository: str, version: str) -> str:
    """Return Markdown with absolute addresses in place of relative ones.

    Args:
        text: Markdown with pictures and links relative to the root of the repository.
        repository: Address of the repository, e.g. ``https://github.com/OWNER/NAME``; if empty,
            pictures are left out and links become their text.
        version: Version of the release, whose tag is ``v<version>``.

    Example:
        >>> absolute_links("[Results](docs/results.md)", "https://example.org/navrl", "1.0")
        '[Results](https://example.org/navrl/blob/v1.0/docs/results.md)'
    """

    def replaced(match: re.Match[str]) -> str:
        mark, shown, path = match.groups()
        if not repository:
            return "" if mark else shown
        kind = "raw" if mark else "blob"
        return f"{mark}[{shown}]({repository.rstrip('/')}/{kind}/v{version}/{path})"

    return _LINK.sub(replaced, text)


class CustomMetadataHook(MetadataHookInterface):
    """Set the long description of the package from README.md."""

    def update(self, metadata: dict) -> None:
        """Add ``readme`` to the project's metadata."""
        root = Path(self.root)
        source = (root / "navrl" / "__init__.py").read_text()
        (version,) = re.findall(r'^__version__ = "([^"]+)"', source, re.M)
        text = (root / "README.md").read_text()
        shown = absolute_links(text, os.environ.get(VARIABLE, ""), version)
        metadata["readme"] = {"content-type": "text/markdown", "text": shown}
