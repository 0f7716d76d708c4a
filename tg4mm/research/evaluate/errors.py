"""What can be wrong with the input of an evaluation, beyond the capture and the run themselves."""

from tg4mm.core.errors import Tg4mmError


class EvaluationError(Tg4mmError):
    """Metric weights that cannot be used, or a request for an evaluation that makes no sense."""
