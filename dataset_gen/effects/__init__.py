"""What a real camera adds to a record: shake, drifting exposure, flickering light, a video codec. All seeded."""

from __future__ import annotations

from .record import CODECS, Effects, Record

__all__ = ["CODECS", "Effects", "Record"]
