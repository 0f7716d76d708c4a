"""Evaluation: image metrics, displacement error, what nothing and what the exact motion would score.

The names are imported when they are first asked for (tg4mm/core/lazy.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tg4mm.core.lazy import lazily

if TYPE_CHECKING:
    from tg4mm.research.evaluate.errors import EvaluationError
    from tg4mm.research.evaluate.run import evaluate_run
    from tg4mm.research.evaluate.table import format_table

__all__ = ["EvaluationError", "evaluate_run", "format_table"]

__getattr__ = lazily(
    __name__,
    {
        "EvaluationError": "errors",
        "evaluate_run": "run",
        "format_table": "table",
    },
)
