"""Resolve links from notebooks to pages: mkdocs does it for Markdown files only."""

import posixpath
import re

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

_LINK = re.compile(r'href="(?!\w+:)([^"#]+\.(?:md|ipynb))(#[^"]*)?"')


def on_page_content(html: str, page: Page, files: Files, **_: object) -> str:
    """Replace links to files of the documentation by their addresses in the site.

    Raises:
        PluginError: If a file does not exist.
    """
    source = page.file.src_uri
    if not source.endswith(".ipynb"):
        return html

    def address(link: re.Match) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link[1]))
        file = files.get_file_from_path(target)
        if file is None:
            raise PluginError(f"{source}: links to {link[1]}, which does not exist")
        return f'href="{file.url_relative_to(page.file)}{link[2] or ""}"'

    return _LINK.sub(address, html)
