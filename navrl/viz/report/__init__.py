"""One self-contained HTML page about a run or a sweep."""

from navrl.viz.report.page import write_report

__all__ = ["write_report"]
