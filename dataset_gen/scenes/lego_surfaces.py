"""Surfaces of the toy bulldozer: worn plastic in its colours, lettered studs, prints, chrome, lenses."""

from functools import cache

import numpy as np

from .. import textures as t
from ..scene import Surface
from ..shapes.bricks import ATLAS

Rgb = tuple[float, float, float]
_DUST = (0.66, 0.6, 0.52)
_YELLOW = (0.95, 0.72, 0.07)
_GREY = (0.55, 0.56, 0.57)
_DARK = (0.24, 0.25, 0.27)
_BLACK = (0.13, 0.13, 0.14)
_RED = (0.78, 0.1, 0.08)
_SAND = (0.66, 0.61, 0.52)

# Which parts are of which colour; each colour has one texture, of which every brick shows its own place.
_COLOURS = {
    _SAND: ("base",),
    _YELLOW: ("chassis", "body", "fender", "cab", "blade", "arms"),
    _GREY: ("grey", "wheels"),
    _DARK: ("frame", "engine", "teeth", "claws", "ripper"),
    _BLACK: ("tracks", "axles", "pins", "blade_pins", "cab_pins", "cab_trim", "controls", "pistons"),
    _RED: ("seat", "red", "lights"),
}
_PLASTIC = {name: colour for colour, names in _COLOURS.items() for name in names}
_STUDS = ("base", "chassis", "body", "fender", "cab", "blade", "grey", "frame", "cab_trim", "lights")


def _scratches(size: int, rng: np.random.Generator, count: int) -> np.ndarray:
    """Mask [size, size] of thin straight scratches of all directions, periodic."""
    mask = np.zeros((size, size))
    for _ in range(count):
        start, heading = rng.random(2) * size, rng.random() * np.pi
        length, weight = size * rng.uniform(0.03, 0.16), rng.uniform(0.3, 1.0)
        along = np.arange(0.0, length, 0.7)
        fade = weight * np.sin(np.pi * (along + 0.5) / (length + 1.0)) ** 0.5
        bend = rng.normal(0.0, 0.02) * along**2 / length
        x = (start[0] + along * np.cos(heading) - bend * np.sin(heading)).astype(int) % size
        y = (start[1] + along * np.sin(heading) + bend * np.cos(heading)).astype(int) % size
        np.maximum.at(mask, (y, x), fade)
        np.maximum.at(mask, (y, (x + 1) % size), 0.6 * fade)
    return mask


def moulded(
    colour: Rgb,
    rng: np.random.Generator,
    size: int = 768,
    mottle: float = 0.1,
    grain: float = 0.1,
    wear: float = 0.5,
    dust: float = 0.3,
) -> tuple[np.ndarray, np.ndarray]:
    """Tiling plastic: colour [size, size, 3] and roughness [size, size]; the tile is about 8 studs wide."""
    image = t.speckle(t.flat(size, size, colour), rng, mottle, (9, 9))
    image = t.speckle(image, rng, grain, (46, 46))
    specks = np.clip(t.noise(size, size, (60, 60), rng) - 1.9, 0.0, 1.0)
    image = image * (1.0 - 0.55 * specks[..., None])
    lines = _scratches(size, rng, 300)
    light = tuple(0.45 * c + 0.55 * 0.95 for c in colour)
    image = t.paint(image, wear * lines, (light[0], light[1], light[2]))
    film = np.clip(
        0.4 * t.noise(size, size, (5, 5), rng) + 0.5 * t.noise(size, size, (34, 34), rng), 0.0, 1.0
    )
    image = t.paint(image, dust * film, _DUST)
    rough = np.clip(0.3 + 0.25 * lines + 0.35 * dust * film + 0.25 * specks, 0.05, 1.0)
    return np.clip(image, 0.0, 1.0), rough


def stud_tops(
    colour: Rgb, rng: np.random.Generator, atlas: int, text: str = "TG4M", cell: int = 128
) -> tuple[np.ndarray, np.ndarray]:
    """`atlas`² tops of studs: colour [N, N, 3] and the height of the letters [N, N], N = atlas · cell."""
    size = atlas * cell
    image, _ = moulded(colour, rng, size, 0.06, 0.08, 0.5, 0.15)
    letters = t.lettering(text, max(1, cell // 44))
    pad = np.zeros((cell, cell))
    one = t.stamp(pad, letters, 0.5, 0.52)
    heights = np.tile(one, (atlas, atlas))
    soft = _blurred(heights, 1.2)
    # Dirt gathers beside the letters and their tops are rubbed bright.
    dirt = np.clip(_blurred(heights, 2.5) - heights, 0.0, 1.0)
    image = image * (1.0 - 0.6 * dirt[..., None])
    light = tuple(0.7 * c + 0.3 for c in colour)
    image = t.paint(image, 0.5 * heights, (light[0], light[1], light[2]))
    return np.clip(image, 0.0, 1.0), np.clip(soft, 0.0, 1.0)


def _blurred(image: np.ndarray, width: float) -> np.ndarray:
    fy, fx = np.fft.fftfreq(image.shape[0])[:, None], np.fft.rfftfreq(image.shape[1])[None]
    gain = np.exp(-2.0 * (np.pi * width) ** 2 * (fy**2 + fx**2))
    return np.fft.irfft2(np.fft.rfft2(image) * gain, s=image.shape)


def hazard(height: int, width: int, rng: np.random.Generator, stripes: int = 6) -> np.ndarray:
    """Black and yellow warning stripes, rubbed [height, width, 3]."""
    slope = height / width * stripes
    wave = t.diagonal(height, width, slope, stripes) > 0.5
    image = t.paint(t.flat(height, width, (0.93, 0.72, 0.06)), wave.astype(float), (0.07, 0.07, 0.08))
    cells = (max(4, height // 12), max(4, width // 12))
    rubbed = np.clip(t.noise(height, width, cells, rng) - 1.1, 0.0, 1.0)
    return np.clip(t.paint(t.speckle(image, rng, 0.15, cells), 0.8 * rubbed, (0.7, 0.64, 0.5)), 0.0, 1.0)


_rng = t.seeded(2025, 100)


@cache
def _worn(colour: Rgb) -> tuple[np.ndarray, np.ndarray]:
    number, dark = 10 + list(_COLOURS).index(colour), max(colour) < 0.4
    size = 768 if colour in (_YELLOW, _SAND) else 512
    mottle, grain = (0.2, 0.3) if dark else (0.05, 0.1)
    return moulded(colour, _rng(number), size, mottle, grain, 0.55, 0.3 if dark else 0.16)


def _plastic(name: str) -> Surface:
    image, rough = _worn(_PLASTIC[name])
    return Surface(name, image, roughness=rough, ior=1.53)


def _studs(name: str) -> Surface:
    image, relief = _tops(_PLASTIC[name])
    return Surface(f"{name}_studs", image, relief, 0.003, roughness=0.38, ior=1.53)


@cache
def _tops(colour: Rgb) -> tuple[np.ndarray, np.ndarray]:
    return stud_tops(colour, _rng(20 + list(_COLOURS).index(colour)), ATLAS)


def _label() -> Surface:
    h, w = 192, 1152
    image = t.flat(h, w, (0.93, 0.73, 0.1))
    stripes = hazard(h, 144, _rng(1), 3)
    image[:, :144], image[:, -144:] = stripes, stripes[:, ::-1]
    ink = t.stamp(np.zeros((h, w)), t.lettering("TG4M 2025", 14), 0.53, 0.5)
    image = t.paint(image, ink, (0.08, 0.08, 0.09))
    line = t.band(h, w, 0.06, 0.11) + t.band(h, w, 0.89, 0.94)
    line[:, :160], line[:, -160:] = 0.0, 0.0
    image = t.speckle(t.paint(image, line, _RED), _rng(2), 0.12, (20, 120))
    return Surface("label", image, roughness=0.35, coat=0.3)


def _chrome(name: str) -> Surface:
    image = t.speckle(t.flat(256, 256, (0.74, 0.74, 0.75)), _rng(4), 0.22, (18, 10))
    return Surface(name, image, metallic=0.85, roughness=0.32)


def _lens(name: str, colour: Rgb) -> Surface:
    image = t.paint(t.flat(128, 128, colour), 0.35 * t.knurl(128, 128, 12.0, 12), (1.0, 1.0, 1.0))
    image = t.speckle(image, _rng(5), 0.12, (20, 20))
    return Surface(name, image, roughness=0.25, coat=0.6)


def surfaces() -> dict[str, Surface]:
    """Surface by part name."""
    out = {name: _plastic(name) for name in _PLASTIC}
    out |= {f"{name}_studs": _studs(name) for name in _STUDS}
    stripes = Surface("stripes", hazard(160, 512, _rng(3), 5), roughness=0.4)
    out |= {"label": _label(), "stripes": stripes, "chrome": _chrome("chrome"), "rods": _chrome("rods")}
    out |= {
        "lens": _lens("lens", (0.93, 0.92, 0.84)),
        "cab_lens": _lens("cab_lens", (0.93, 0.92, 0.84)),
        "beacon": _lens("beacon", (0.95, 0.45, 0.05)),
    }
    return out
