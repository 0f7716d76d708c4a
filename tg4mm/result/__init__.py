"""What a finished run found, in one object: `train` prints it, `--band auto` takes it, reports and viewers show it."""

from tg4mm.result.lines import lines_of
from tg4mm.result.model import Length, Result, Vibration
from tg4mm.result.read import result_of

__all__ = ["Length", "Result", "Vibration", "lines_of", "result_of"]
