"""The report of a run: one self-contained HTML file with videos, figures and scores.

The names are imported when they are first asked for (tg4mm/core/lazy.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tg4mm.core.lazy import lazily

if TYPE_CHECKING:
    from tg4mm.show.report.write import ReportOptions, write_report

__all__ = ["ReportOptions", "write_report"]

__getattr__ = lazily(
    __name__,
    {
        "ReportOptions": "write",
        "write_report": "write",
    },
)
