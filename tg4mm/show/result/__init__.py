"""The result of a finished run in one object, for `train`, `--band auto`, reports and viewers."""

from tg4mm.show.result.model import Length, Result, Vibration, lines_of
from tg4mm.show.result.read import result_of

__all__ = ["Length", "Result", "Vibration", "lines_of", "result_of"]
