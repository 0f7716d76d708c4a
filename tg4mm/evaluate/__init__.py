"""Evaluation: image metrics, displacement error, what nothing and what the exact motion would score."""

from tg4mm.evaluate.errors import EvaluationError
from tg4mm.evaluate.run import evaluate_run
from tg4mm.evaluate.table import format_table

__all__ = ["EvaluationError", "evaluate_run", "format_table"]
