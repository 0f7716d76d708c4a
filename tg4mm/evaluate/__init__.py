"""Evaluation: image metrics, displacement error, what nothing and what the exact motion would score.

The names are imported when they are first asked for: what lies beside them here and needs no torch (pages, charts,
picture files, image metrics) can then be imported without it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tg4mm.evaluate.errors import EvaluationError
    from tg4mm.evaluate.run import evaluate_run
    from tg4mm.evaluate.table import format_table

_WHERE = {
    "EvaluationError": "tg4mm.evaluate.errors",
    "evaluate_run": "tg4mm.evaluate.run",
    "format_table": "tg4mm.evaluate.table",
}

__all__ = ["EvaluationError", "evaluate_run", "format_table"]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_WHERE[name]), name)
