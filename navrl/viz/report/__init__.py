"""Self-contained HTML report of runs and sweeps."""

from navrl.viz.report.page import write_report

__all__ = ["write_report"]
