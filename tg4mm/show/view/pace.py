"""How many pixels a moving picture gets, so that it keeps up with its frame rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

RATE = 30.0  # pictures a second that playing aims at
_COARSEST = 0.4  # of the canvas' sides; below, fewer pictures a second are better than fewer pixels
_FINEST = 2400  # pixels, longer side


@dataclass(frozen=True)
class Pace:
    """Pixels of the next picture, found from how long the last ones took."""

    pixels: float = 768.0 * 768.0

    def size(self, width: int, height: int) -> tuple[int, int]:
        """(width, height) of a picture of the canvas' shape, at most the canvas' own."""
        share = math.sqrt(self.pixels / (width * height))
        return _scaled(width, height, min(1.0, max(share, _COARSEST)))

    def after(self, seconds: float, drawn: int) -> Pace:
        """The pace after a picture of `drawn` pixels took `seconds`; small misses change nothing."""
        aim = 0.85 / RATE
        if 0.6 * aim < seconds <= aim:
            return self
        factor = min(max(aim / max(seconds, 1e-4), 0.6), 1.1)
        return replace(self, pixels=min(max(drawn * factor, 100.0**2), float(_FINEST) ** 2))


def full_size(width: int, height: int) -> tuple[int, int]:
    """(width, height) of a still picture: the canvas' own, its longer side held to 2400 pixels."""
    return _scaled(width, height, 1.0)


def _scaled(width: int, height: int, share: float) -> tuple[int, int]:
    share = min(share, _FINEST / max(width, height))
    return max(1, round(width * share)), max(1, round(height * share))
