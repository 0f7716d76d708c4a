"""The report of a run: one self-contained HTML file with videos, figures and scores.

The names are imported when they are first asked for: what lies beside them here and needs no torch (pages, charts,
picture files, image metrics) can then be imported without it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tg4mm.report.write import ReportOptions, write_report

_WHERE = {
    "ReportOptions": "tg4mm.report.write",
    "write_report": "tg4mm.report.write",
}

__all__ = ["ReportOptions", "write_report"]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_WHERE[name]), name)
