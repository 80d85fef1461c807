"""Puts the table of metrics into a page in place of ``<!-- metrics -->``: rows are code."""

from navrl.evaluation.metrics import markdown_table

MARK = "<!-- metrics -->"


def on_page_markdown(markdown, **_):
    """Replace the mark; a page without one stays as it is."""
    return markdown.replace(MARK, markdown_table()) if MARK in markdown else markdown
