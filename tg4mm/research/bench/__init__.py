"""The benchmark: presets against ground truth on many datasets, as tables and pictures."""

from tg4mm.core.errors import Tg4mmError


class BenchError(Tg4mmError):
    """A dataset without ground truth, or a folder that holds something else."""
