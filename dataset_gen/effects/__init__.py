"""Effects of a real camera: shake, exposure drift, flicker, rolling shutter, a codec. All are seeded."""

from .options import CODECS, Effects
from .record import RecordingEffects

__all__ = ["CODECS", "Effects", "RecordingEffects"]
