"""What a video's compression takes from small motion: measured by sending a known motion through the same encoder."""

from tg4mm.capture.codec.loss import Loss, before_compression, codec_losses
from tg4mm.capture.codec.trial import Tone, is_lossless

__all__ = ["Loss", "Tone", "before_compression", "codec_losses", "is_lossless"]
