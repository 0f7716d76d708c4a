"""What a real camera adds to a record: shake, drifting exposure, flicker, rows in turn, a codec. All seeded."""

from .options import CODECS, Effects
from .record import Record

__all__ = ["CODECS", "Effects", "Record"]
