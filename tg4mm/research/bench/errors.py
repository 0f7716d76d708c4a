"""What can be wrong with the request for a benchmark."""

from tg4mm.core.errors import Tg4mmError


class BenchError(Tg4mmError):
    """A dataset without ground truth, an ablation that is none, or a folder that holds something else."""


class StepError(BenchError):
    """A program that a part of a benchmark needs has failed."""
