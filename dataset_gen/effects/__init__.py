"""What a real camera adds to a record: shake, drifting exposure, flickering light, a video codec. All seeded."""

from __future__ import annotations

from .describe import CODECS, Effects
from .record import Record

__all__ = ["CODECS", "Effects", "Record"]
