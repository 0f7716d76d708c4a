"""Loss of small motion by a video's compression, measured by encoding a known motion in the same way."""

from tg4mm.capture.codec.loss import LOST, Loss, before_compression, codec_losses, coded_change
from tg4mm.capture.codec.trial import MeasuredTone, is_lossless

__all__ = [
    "LOST",
    "Loss",
    "MeasuredTone",
    "before_compression",
    "codec_losses",
    "coded_change",
    "is_lossless",
]
