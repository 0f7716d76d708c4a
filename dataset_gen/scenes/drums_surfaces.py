"""Surfaces of the drum kit: red glitter, chrome, bronze, coated heads, black paint, leather, the rug."""

from __future__ import annotations

from functools import cache

import numpy as np

from .. import textures as t
from ..patterns import kit
from ..scene import Surface

_IVORY = (0.88, 0.84, 0.74)

_rng = t.seeded(2025, 200)


def shells() -> Surface:
    """Burgundy sparkle under varnish."""
    return Surface("shells", kit.glitter(512, (0.85, 0.07, 0.1), _rng(1)), roughness=0.4, coat=0.5)


def snare_shell() -> Surface:
    """Steel with engraved rings and brush marks."""
    h, w = 256, 512
    image = t.speckle(t.flat(h, w, (0.72, 0.71, 0.7)), _rng(2), 0.16, (60, 6))
    image = t.paint(image, t.knurl(h, w, 3.0, 20) * t.band(h, w, 0.4, 0.6), (0.3, 0.29, 0.28))
    return Surface("snare_shell", image, metallic=0.85, roughness=0.3)


def bass_hoops() -> Surface:
    """Black lacquer with an ivory inlay."""
    image = t.speckle(t.flat(256, 512, (0.13, 0.12, 0.13)), _rng(3), 0.3, (20, 40))
    image = t.paint(image, t.band(256, 512, 0.28, 0.4), (0.8, 0.72, 0.5))
    return Surface("bass_hoops", image, roughness=0.35, coat=0.5)


@cache
def _plating() -> np.ndarray:
    image = t.speckle(t.flat(384, 384, (0.86, 0.86, 0.87)), _rng(4), 0.06, (12, 12))
    pits = np.clip(t.noise(384, 384, (50, 50), _rng(5)) - 2.1, 0.0, 0.8)
    return np.asarray(t.paint(image, pits, (0.4, 0.34, 0.28)))


def chrome(name: str) -> Surface:
    """Chrome plate with pits and stains."""
    return Surface(name, _plating(), metallic=0.95, roughness=0.2)


def cymbal(name: str, number: int, hammered: float, text: str) -> Surface:
    """Bronze of one cymbal, lathed and hammered in its own way."""
    image, relief = kit.bronze(512, 1024, _rng(20 + number), hammered, text)
    return Surface(name, image, relief, 0.0015, 0.85, 0.34)


def batter(name: str, number: int) -> Surface:
    return Surface(name, kit.coated_head(512, _rng(40 + number)), roughness=0.65)


def front_head() -> Surface:
    return Surface("bass_front", kit.front_head(768, _rng(6)), roughness=0.45)


def resonant() -> Surface:
    """Clear film over the dark inside, as an opaque grey: seen from below only."""
    image = t.speckle(t.flat(128, 128, (0.5, 0.5, 0.5)), _rng(7), 0.15, (12, 12))
    return Surface("undersides", image, roughness=0.35)


def rubber(name: str) -> Surface:
    image = t.speckle(t.flat(128, 128, (0.16, 0.16, 0.165)), _rng(8), 0.35, (14, 14))
    return Surface(name, image, roughness=0.8)


def black(name: str) -> Surface:
    """Painted castings."""
    image = t.speckle(t.flat(256, 256, (0.2, 0.2, 0.21)), _rng(9), 0.4, (20, 20))
    return Surface(name, image, metallic=0.3, roughness=0.45)


def felt() -> Surface:
    image = t.speckle(t.flat(128, 128, (0.62, 0.12, 0.11)), _rng(10), 0.35, (24, 24))
    return Surface("felts", image, roughness=0.95, sheen=0.4)


def leather() -> Surface:
    """The seat: black leather, creased."""
    h = 512
    creases = np.abs(t.noise(h, h, (18, 18), _rng(11)))
    grain = np.clip(0.25 + 0.5 * creases, 0.0, 1.0)
    image = t.speckle(t.flat(h, h, (0.23, 0.21, 0.2)), _rng(12), 0.25, (30, 30)) * (
        0.6 + 0.6 * grain[..., None]
    )
    return Surface("seat", np.clip(image, 0.0, 1.0), grain, 0.003, roughness=0.5)


def piping() -> Surface:
    image = t.paint(t.flat(32, 512, (0.6, 0.1, 0.1)), t.diagonal(32, 512, 1.0, 90) > 0.6, _IVORY)
    return Surface("piping", image, roughness=0.6)


def wood() -> Surface:
    """Hickory of the sticks and the beater's shaft."""
    grain = t.noise(256, 128, (3, 30), _rng(13))
    image = t.flat(256, 128, (0.8, 0.62, 0.4)) * (1.0 + 0.12 * grain[..., None])
    ink = t.band(256, 128, 0.3, 0.34) + t.band(256, 128, 0.36, 0.37)
    return Surface("sticks", np.clip(t.paint(image, ink, (0.1, 0.1, 0.1)), 0.0, 1.0), roughness=0.55)


def rug() -> Surface:
    image, relief = kit.rug(768, _rng(14))
    return Surface("rug", image, relief, 0.004, roughness=0.95, sheen=0.2)
