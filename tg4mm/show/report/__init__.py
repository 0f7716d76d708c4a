"""The report of a run: one self-contained HTML file with videos, figures and scores."""

from tg4mm.show.options import ReportOptions
from tg4mm.show.report.write import write_report

__all__ = ["ReportOptions", "write_report"]
