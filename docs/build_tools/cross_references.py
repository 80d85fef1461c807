"""Docstrings name things as Sphinx does (``:func:`navrl.x.y```); the site turns them into links."""

import re

import griffe

ROLE = re.compile(r":(?:func|class|mod|meth|attr|data):`([\w.]+)`")


def link(found: re.Match) -> str:
    """Give an optional link: a name without an entry of its own stays plain code."""
    name = found[1]
    shown = f"<code>{name}</code>"
    return f'<autoref optional identifier="{name}">{shown}</autoref>' if "." in name else shown


class CrossReferences(griffe.Extension):
    """Rewrites the roles of each docstring before it is rendered."""

    def on_instance(self, *, obj, **_):
        if obj.docstring:
            obj.docstring.value = ROLE.sub(link, obj.docstring.value)
