"""What a finished run found, in one object: `train` prints it, `--band auto` takes it, reports and viewers show it."""

from tg4mm.show.result.model import Length, Result, Vibration, lines_of
from tg4mm.show.result.read import result_of

__all__ = ["Length", "Result", "Vibration", "lines_of", "result_of"]
