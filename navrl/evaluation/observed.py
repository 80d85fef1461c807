"""Text on the observations of the policies of a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from navrl.evaluation.comparison import ComparisonRow


def observed_text(rows: Sequence[ComparisonRow], name: Callable[[str], str]) -> str:
    """Return a sentence with what each policy may read; empty if it is not known of any.

    Args:
        rows: Rows of a table.
        name: Formats and escapes a name.
    """
    groups: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        groups.setdefault(row.observes, []).append(name(row.policy))
    unknown = groups.pop((), None)
    if not groups:
        return ""
    parts = [
        f"{', '.join(map(_plain, sources))}: {', '.join(policies)}"
        for sources, policies in groups.items()
    ]
    parts += [f"not recorded: {', '.join(unknown)}"] if unknown else []
    return f"What each policy may read. {'; '.join(parts)}."


def _plain(source: str) -> str:
    """Return a source without characters that a table would interpret."""
    return "".join(letter for letter in source if letter.isalnum() or letter in " -")
