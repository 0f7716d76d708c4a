"""Evaluation: image metrics, displacement error, what nothing and what the exact motion would score."""

from tg4mm.core.errors import Tg4mmError


class EvaluationError(Tg4mmError):
    """Metric weights that cannot be used, or a request for an evaluation that makes no sense."""
