"""Surfaces of the drum kit: glitter, chrome, bronze, coated heads with prints, black paint, leather, the rug."""

from functools import cache

import numpy as np

from .. import textures as t
from ..scene import Surface

Rgb = tuple[float, float, float]
_IVORY = (0.88, 0.84, 0.74)


def glitter(size: int, colour: Rgb, rng: np.random.Generator, flakes: int = 12000) -> np.ndarray:
    """Tiling sparkle: flakes that catch the light differently, in a deep colour [size, size, 3]."""
    lightness = 0.7 + 0.08 * t.noise(size, size, (6, 6), rng)
    y, x = rng.integers(0, size, (2, flakes))
    shine = rng.gamma(1.2, 0.35, flakes)
    for dy, dx in ((0, 0), (0, 1), (1, 0), (1, 1)):
        lightness[(y + dy) % size, (x + dx) % size] = 0.45 + shine
    base = t.flat(size, size, colour) * lightness[..., None]
    white = np.clip(lightness - 1.0, 0.0, 0.8)
    return np.clip(t.paint(base, white, (1.0, 0.92, 0.85)), 0.0, 1.0)


def bronze(
    height: int, width: int, rng: np.random.Generator, hammered: float, text: str
) -> tuple[np.ndarray, np.ndarray]:
    """A cymbal around × along its outline: colour and height. Rings of the lathe, dents, stains, a print.

    The top lies at v > 0.5, its edge at 0.5.
    """
    ring = 0.5 * t.noise(height, 1, (90, 1), rng) + 0.5 * t.noise(height, 1, (240, 1), rng)
    ring = np.broadcast_to(ring, (height, width))
    dents = np.clip(t.noise(height, width, (26, 34), rng) - 0.9, 0.0, 1.5)
    stain = t.noise(height, width, (5, 4), rng)
    gain = 1.0 + 0.13 * ring - 0.22 * hammered * dents + 0.05 * stain
    gain = gain + 0.05 * t.noise(height, width, (120, 200), rng)
    image = t.flat(height, width, (0.86, 0.66, 0.33)) * gain[..., None]
    prints = np.clip(t.noise(height, width, (34, 60), rng) - 1.9, 0.0, 1.0)  # fingerprints, dull and brown
    image = t.paint(image, 0.6 * prints, (0.42, 0.3, 0.16))
    ink = np.zeros((height, width))
    letters = t.lettering(text, max(2, width // 340))
    # Read from outside, with the edge at the foot of the letters; u runs counter-clockwise seen from above.
    for u in (0.12, 0.62):
        ink = t.stamp(ink, letters, 0.62, u)
    ink = np.maximum(ink, t.band(height, width, 0.548, 0.552))
    image = t.paint(image, 0.85 * ink, (0.12, 0.09, 0.07))
    relief = np.clip(0.5 + 0.16 * ring - 0.3 * hammered * dents, 0.0, 1.0)
    return np.clip(image, 0.0, 1.0), relief


def _disc(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Radius (1 at the edge) and angle of a square picture's pixels, each [size, size]."""
    a = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    return np.hypot(a[:, None], a[None]), np.arctan2(a[:, None], a[None])


def coated_head(size: int, rng: np.random.Generator, text: str = "TG4M") -> np.ndarray:
    """A played drum head: white coating, grey where the sticks land, a small print at its rim."""
    r, _ = _disc(size)
    image = t.speckle(t.flat(size, size, (0.86, 0.85, 0.81)), rng, 0.07, (60, 60))
    worn = np.exp(-((r / 0.42) ** 2)) * np.clip(0.6 + 0.6 * t.noise(size, size, (9, 9), rng), 0.0, 1.4)
    image = t.paint(image, np.clip(0.38 * worn, 0.0, 1.0), (0.42, 0.41, 0.4))
    marks = _strokes(size, rng, 170)
    image = t.paint(image, 0.55 * marks * (r < 0.85), (0.3, 0.29, 0.28))
    image = t.paint(image, ((r > 0.93) & (r < 0.945)).astype(float), (0.3, 0.3, 0.32))
    ink = t.stamp(np.zeros((size, size)), t.lettering(text, max(1, size // 130)), 0.2, 0.5)
    return np.clip(t.paint(image, 0.9 * ink, (0.12, 0.12, 0.14)), 0.0, 1.0)


def _strokes(size: int, rng: np.random.Generator, count: int) -> np.ndarray:
    """Mask of short dark marks of sticks, thickest around the middle."""
    mask = np.zeros((size, size))
    for _ in range(count):
        y, x = size * (0.5 + 0.17 * rng.standard_normal(2))
        heading, length = rng.random() * np.pi, size * rng.uniform(0.01, 0.05)
        along = np.arange(-length, length, 0.7)
        rows = np.clip(y + along * np.sin(heading), 0, size - 2).astype(int)
        columns = np.clip(x + along * np.cos(heading), 0, size - 2).astype(int)
        fade = rng.uniform(0.3, 1.0) * (1.0 - (along / length) ** 2)
        for dy, dx in ((0, 0), (1, 0), (0, 1)):
            np.maximum.at(mask, (rows + dy, columns + dx), fade)
    return mask


def printed_head(size: int, rng: np.random.Generator) -> np.ndarray:
    """The bass drum's front: ivory with a red sunburst ring, a black band and big lettering."""
    r, angle = _disc(size)
    image = t.flat(size, size, (0.9, 0.87, 0.78))
    rays = (np.sin(16.0 * angle) > 0.0) & (r > 0.56) & (r < 0.78)
    image = t.paint(image, rays.astype(float), (0.7, 0.1, 0.1))
    image = t.paint(image, ((r > 0.8) & (r < 0.9)).astype(float), (0.1, 0.1, 0.12))
    dots = (np.sin(24.0 * angle) > 0.55) & (r > 0.83) & (r < 0.87)
    image = t.paint(image, dots.astype(float), (0.86, 0.68, 0.3))
    image = t.paint(image, ((r > 0.5) & (r < 0.53)).astype(float), (0.1, 0.1, 0.12))
    ink = t.stamp(np.zeros((size, size)), t.lettering("TG4M", size // 62), 0.55, 0.508)
    ink = t.stamp(ink, t.lettering("SINCE 2025", max(1, size // 190)), 0.4, 0.504)
    image = t.paint(image, ink, (0.1, 0.1, 0.12))
    image = t.speckle(image, rng, 0.1, (50, 50))
    scuffs = np.clip(t.noise(size, size, (30, 30), rng) - 1.8, 0.0, 1.0)
    return np.clip(t.paint(image, 0.6 * scuffs, (0.5, 0.47, 0.42)), 0.0, 1.0)


def woven(size: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A round woven rug: rings of ornaments; colour and the height of the weave."""
    r, angle = _disc(size)
    image = t.flat(size, size, (0.36, 0.09, 0.1))
    navy, ivory, ochre = (0.1, 0.13, 0.25), (0.78, 0.7, 0.55), (0.7, 0.47, 0.2)
    for r0, r1, colour in ((0.86, 0.97, navy), (0.62, 0.66, ochre), (0.3, 0.34, ochre), (0.0, 0.16, navy)):
        image = t.paint(image, ((r > r0) & (r < r1)).astype(float), colour)
    for centre, width, count, colour in ((0.915, 0.03, 72, ivory), (0.76, 0.075, 36, ochre), (0.76, 0.04, 36, navy),
                                         (0.48, 0.1, 18, ivory), (0.48, 0.06, 18, navy), (0.23, 0.045, 12, ivory),
                                         (0.08, 0.05, 6, ochre)):  # fmt: skip
        wave = np.abs((angle / (2 * np.pi) * count) % 1.0 - 0.5) * 2.0
        diamond = np.abs(r - centre) / width + wave < 0.85
        image = t.paint(image, diamond.astype(float), colour)
    for edge in (0.16, 0.34, 0.62, 0.66, 0.86, 0.97):
        image = t.paint(image, (np.abs(r - edge) < 0.006).astype(float), ivory)
    weave = t.knurl(size, size, 150.0, 150)
    image = t.speckle(image, rng, 0.28, (90, 90)) * (0.8 + 0.25 * weave[..., None])
    return np.clip(image, 0.0, 1.0), weave


_rng = t.seeded(2025, 200)


def shells() -> Surface:
    return Surface("shells", glitter(512, (0.85, 0.07, 0.1), _rng(1)), roughness=0.4, coat=0.5)


def snare_shell() -> Surface:
    h, w = 256, 512
    image = t.speckle(t.flat(h, w, (0.72, 0.71, 0.7)), _rng(2), 0.16, (60, 6))
    image = t.paint(image, t.knurl(h, w, 3.0, 20) * t.band(h, w, 0.4, 0.6), (0.3, 0.29, 0.28))
    return Surface("snare_shell", image, metallic=0.85, roughness=0.3)


def bass_hoops() -> Surface:
    image = t.speckle(t.flat(256, 512, (0.13, 0.12, 0.13)), _rng(3), 0.3, (20, 40))
    image = t.paint(image, t.band(256, 512, 0.28, 0.4), (0.8, 0.72, 0.5))
    return Surface("bass_hoops", image, roughness=0.35, coat=0.5)


@cache
def _plating() -> np.ndarray:
    image = t.speckle(t.flat(384, 384, (0.86, 0.86, 0.87)), _rng(4), 0.06, (12, 12))
    pits = np.clip(t.noise(384, 384, (50, 50), _rng(5)) - 2.1, 0.0, 0.8)
    return np.asarray(t.paint(image, pits, (0.4, 0.34, 0.28)))


def chrome(name: str) -> Surface:
    return Surface(name, _plating(), metallic=0.95, roughness=0.2)


def cymbal(name: str, number: int, hammered: float, text: str) -> Surface:
    image, relief = bronze(512, 1024, _rng(20 + number), hammered, text)
    return Surface(name, image, relief, 0.0015, 0.85, 0.34)


def batter(name: str, number: int) -> Surface:
    return Surface(name, coated_head(512, _rng(40 + number)), roughness=0.65)


def front_head() -> Surface:
    return Surface("bass_front", printed_head(768, _rng(6)), roughness=0.45)


def resonant() -> Surface:
    image = t.speckle(t.flat(128, 128, (0.5, 0.5, 0.5)), _rng(7), 0.15, (12, 12))
    return Surface("undersides", image, roughness=0.35)


def rubber(name: str) -> Surface:
    image = t.speckle(t.flat(128, 128, (0.16, 0.16, 0.165)), _rng(8), 0.35, (14, 14))
    return Surface(name, image, roughness=0.8)


def black(name: str) -> Surface:
    image = t.speckle(t.flat(256, 256, (0.2, 0.2, 0.21)), _rng(9), 0.4, (20, 20))
    return Surface(name, image, metallic=0.3, roughness=0.45)


def felt() -> Surface:
    image = t.speckle(t.flat(128, 128, (0.62, 0.12, 0.11)), _rng(10), 0.35, (24, 24))
    return Surface("felts", image, roughness=0.95, sheen=0.4)


def leather() -> Surface:
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
    grain = t.noise(256, 128, (3, 30), _rng(13))
    image = t.flat(256, 128, (0.8, 0.62, 0.4)) * (1.0 + 0.12 * grain[..., None])
    ink = t.band(256, 128, 0.3, 0.34) + t.band(256, 128, 0.36, 0.37)
    return Surface("sticks", np.clip(t.paint(image, ink, (0.1, 0.1, 0.1)), 0.0, 1.0), roughness=0.55)


def rug() -> Surface:
    image, relief = woven(768, _rng(14))
    return Surface("rug", image, relief, 0.004, roughness=0.95, sheen=0.2)
