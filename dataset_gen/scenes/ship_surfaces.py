"""Surfaces of the ship and her sea: planks, paint and gilding, rope, canvas, iron, and the water itself."""

import numpy as np

from .. import textures as t
from ..patterns import furnishing
from ..scene import Rgb, Surface

_GILT = (0.62, 0.45, 0.20)

_rng = t.seeded(2031)


def hull() -> Surface:
    """Tarred oak strakes, pale tallow below the waterline, worn and streaked; v runs from keel to sheer."""
    h, w = 640, 1536
    boards = furnishing.planks(h, w, 30, 5.0, _rng(1), 0.13)
    fibres = furnishing.grain(h, w, _rng(2), 22, 150)
    image = furnishing.planked((0.40, 0.265, 0.165), boards, fibres, (0.3, 0.28))
    v = ((np.arange(h) + 0.5) / h)[:, None]
    streaks = np.clip(t.noise(h, w, (3, 90), _rng(3)), 0.0, 2.0) * 0.16
    image *= (1.0 - streaks * (0.4 + 0.6 * v))[..., None]
    stripe = ((v > 0.845) & (v < 0.905)).astype(float) * np.ones((1, w))
    ochre = np.array([0.66, 0.47, 0.2]) * (1.0 + 0.16 * boards.tone + 0.16 * fibres)[..., None]
    image = np.where((stripe * (1.0 - boards.seam))[..., None] > 0, np.clip(ochre, 0, 1), image)
    wet = np.clip((0.5 - v) / 0.04, 0.0, 1.0)[..., None]
    moss = np.array([0.16, 0.17, 0.12]) * (1.0 + 0.4 * fibres[..., None])
    image = np.clip(image * (1.0 - 0.75 * wet) + 0.75 * wet * moss, 0.0, 1.0)
    return Surface("hull", image, 1.0 - boards.seam, 0.004, roughness=0.62)


def upper_works(name: str, ground: Rgb, number: int) -> Surface:
    h, w = 192, 2048
    boards = furnishing.planks(h, w, 5, 9.0, _rng(number), 0.1)
    image = furnishing.planked(ground, boards, furnishing.grain(h, w, _rng(number + 1), 60, 40), (0.16, 0.2))
    v = ((np.arange(h) + 0.5) / h)[:, None]
    u = ((np.arange(w) + 0.5) / w * 46.0)[None]
    cross, up = np.abs(u % 1.0 - 0.5), np.abs(v - 0.5)
    lozenge = np.abs(cross * 2.0 + up * 2.6 - 0.78) < 0.1
    flower = (np.hypot(cross * 0.9, up * 1.1) < 0.12) | (np.hypot((0.5 - cross) * 0.9, up * 1.1) < 0.07)
    edge = np.broadcast_to((np.abs(up - 0.43) < 0.035), (h, w))
    ink = (lozenge & (up < 0.4)) | flower | edge
    return Surface(
        name, t.paint(image, ink.astype(float), _GILT), ink.astype(float), 0.004, roughness=0.5, coat=0.15
    )


def transom() -> Surface:
    """The stern: planks across, gilt scrolls and lozenges above the waterline; u across, v upwards."""
    h, w = 640, 384
    boards = furnishing.planks(h, w, 34, 1.5, _rng(49), 0.12)
    image = furnishing.planked(
        (0.34, 0.2, 0.12), boards, furnishing.grain(h, w, _rng(50), 5, 150), (0.24, 0.24)
    )
    v = ((np.arange(h) + 0.5) / h)[:, None]
    u = ((np.arange(w) + 0.5) / w)[None]
    cross = np.abs((u * 11.0) % 1.0 - 0.5)
    chain = np.abs(cross * 2.0 + np.abs((v * 21.0) % 1.0 - 0.5) * 1.6 - 0.75) < 0.13
    scroll = np.abs(np.sin(24.0 * u + 3.0 * np.sin(40.0 * v)) * np.cos(34.0 * v)) > 0.86
    ink = np.where(v > 0.66, chain | scroll, False).astype(float)
    moss = np.clip((0.27 - v) / 0.04, 0.0, 0.75) * np.ones((1, w))
    image = t.paint(t.paint(image, ink, _GILT), moss, (0.16, 0.17, 0.12))
    return Surface(
        "transom", np.clip(image, 0, 1), np.maximum(ink, 0.7 * (1.0 - boards.seam)), 0.004, roughness=0.55
    )


def deck() -> Surface:
    h, w = 512, 768
    boards = furnishing.planks(h, w, 20, 2.0, _rng(11), 0.12)
    image = furnishing.planked(
        (0.66, 0.52, 0.36), boards, furnishing.grain(h, w, _rng(12), 10, 120), (0.16, 0.2)
    )
    return Surface("deck", image, 1.0 - boards.seam, 0.002, roughness=0.7)


def bulkhead() -> Surface:
    h, w = 192, 512
    boards = furnishing.planks(w, h, 18, 1.2, _rng(13), 0.12)
    image = furnishing.planked(
        (0.5, 0.33, 0.19), boards, furnishing.grain(w, h, _rng(14), 5, 110), (0.22, 0.24)
    )
    return Surface("bulkhead", image.transpose(1, 0, 2), 1.0 - boards.seam.T, 0.002, roughness=0.6)


def oak() -> Surface:
    """Dark timber of wales, rails, channels, rudder; the fibres along u."""
    image = furnishing.timber(512, 192, (0.23, 0.15, 0.1), _rng(15), 0.42).transpose(1, 0, 2)
    return Surface("oak", image, roughness=0.55)


def wale() -> Surface:
    """The same timber on swept sections, whose length is v: scarphed pieces with bolts."""
    h, w = 2048, 64
    image = furnishing.timber(h, w, (0.17, 0.115, 0.085), _rng(16), 0.45)
    v, u = (np.arange(h) + 0.5) / h * 70.0, (np.arange(w) + 0.5) / w
    bolts = (np.abs(v % 1.0 - 0.5) < 0.1)[:, None] & (np.abs((u * 4.0) % 1.0 - 0.5) < 0.16)[None]
    image = t.paint(image, bolts.astype(float), (0.48, 0.4, 0.3))
    return Surface("wale", image, roughness=0.55)


def joinery() -> Surface:
    """Warm brown timber of hatches, ladders, capstan, boats; the fibres along u."""
    image = furnishing.timber(384, 256, (0.52, 0.33, 0.17), _rng(17), 0.4).transpose(1, 0, 2)
    return Surface("joinery", image, roughness=0.55)


def turned() -> Surface:
    return Surface("turned", furnishing.timber(256, 64, (0.58, 0.37, 0.18), _rng(18), 0.35), roughness=0.5)


def mast() -> Surface:
    h, w = 512, 128
    image = furnishing.timber(h, w, (0.52, 0.34, 0.19), _rng(19), 0.42)
    for v in (0.12, 0.62):
        image = t.paint(image, t.band(h, w, v, v + 0.022), (0.09, 0.08, 0.08))
    turns = t.diagonal(h, w, 256.0 / 2.2, 0)
    hemp = t.band(h, w, 0.34, 0.40) * 0.9
    image = t.paint(image, hemp, (0.6, 0.5, 0.33)) * (1.0 - 0.35 * hemp * turns)[..., None]
    return Surface("mast", np.clip(image, 0, 1), roughness=0.5)


def gilt(name: str = "gilt") -> Surface:
    h, w = 256, 512
    image = t.speckle(t.flat(h, w, _GILT), _rng(20), 0.35, (14, 28))
    worn = np.clip(t.noise(h, w, (10, 20), _rng(21)) - 1.1, 0.0, 1.0)
    return Surface(name, t.paint(image, worn, (0.36, 0.14, 0.08)), metallic=0.45, roughness=0.45)


def rope(name: str, colour: Rgb, number: int) -> Surface:
    image, height = furnishing.laid(128, 32, colour, _rng(number))
    return Surface(name, image, height, 0.002, roughness=0.85)


def canvas() -> Surface:
    image, height = furnishing.canvas(384, 384, (0.87, 0.80, 0.66), _rng(23), 5, (7, 16))
    return Surface("canvas", image, height, 0.01, roughness=0.85, sheen=0.15)


def iron() -> Surface:
    h, w = 256, 256
    image = t.speckle(t.flat(h, w, (0.2, 0.19, 0.19)), _rng(54), 0.4, (10, 12))
    rust = np.clip(0.7 * t.noise(h, w, (8, 10), _rng(25)) - 0.4, 0.0, 0.8)
    return Surface("iron", t.paint(image, rust, (0.42, 0.22, 0.12)), metallic=0.5, roughness=0.5)


def port() -> Surface:
    image = furnishing.timber(128, 96, (0.46, 0.12, 0.08), _rng(26), 0.35).transpose(1, 0, 2)
    return Surface("port", image, roughness=0.5, coat=0.1)


def dark() -> Surface:
    return Surface(
        "dark", t.speckle(t.flat(64, 64, (0.06, 0.05, 0.045)), _rng(27), 0.3, (6, 6)), roughness=0.8
    )


def glass(name: str, colour: Rgb, number: int) -> Surface:
    h, w = 128, 128
    image = t.speckle(t.flat(h, w, colour), _rng(number), 0.35, (4, 4))
    lead = np.maximum(t.diagonal(h, w, 6.0, 4) > 0.93, t.diagonal(h, w, -6.0, 4) > 0.93)
    return Surface(name, t.paint(image, lead.astype(float), (0.12, 0.11, 0.1)), roughness=0.15, coat=0.5)


def flag(name: str, bands: tuple[Rgb, ...], number: int) -> Surface:
    h, w = 192, 384
    weave, height = furnishing.canvas(h, w, (1.0, 1.0, 1.0), _rng(number), 6, (4, 10))
    rows = (np.arange(h) * len(bands) // h)[::-1]
    return Surface(name, weave * np.array(bands)[rows][:, None], height, 0.003, roughness=0.8, sheen=0.2)


def water(height: np.ndarray, hull_distance: np.ndarray) -> Surface:
    """Sea seen from above, maps of the square around it: height of the waves, distance to the hull [units]."""
    n = len(height)
    swell = np.clip(0.5 + height / (4.0 * height.std()), 0.0, 1.0)[..., None]
    image = np.array([0.045, 0.125, 0.145]) * (1.0 - swell) + np.array([0.12, 0.30, 0.31]) * swell
    streaks = 0.6 * t.noise(n, n, (80, 28), _rng(32)) + t.noise(n, n, (34, 14), _rng(33))
    image *= (1.0 + 0.2 * np.tanh(streaks))[..., None]
    lace = 1.0 - np.abs(
        np.tanh(0.9 * t.noise(n, n, (42, 42), _rng(34)) + 0.35 * t.noise(n, n, (100, 100), _rng(35)))
    )
    crest = np.clip((swell[..., 0] - 0.74) / 0.2, 0.0, 1.0) * 0.45
    wash = np.exp(-np.clip(hull_distance, 0.0, None) / 0.05)
    foam = np.clip(lace**3 * (crest + 1.25 * wash) + np.clip(1.5 * wash - 0.85, 0.0, 0.5), 0.0, 1.0)
    image = np.clip(t.paint(image, foam, (0.78, 0.85, 0.83)), 0.0, 1.0)
    ripples = np.clip(0.5 + 0.16 * (t.noise(n, n, (44, 34), _rng(36)) + 0.25 * streaks), 0.0, 1.0)
    rough = np.clip(0.27 + 0.4 * foam, 0.0, 1.0)
    return Surface("water", image, ripples, 0.006, roughness=rough, coat=0.15, coat_roughness=0.2)


def sea_body() -> Surface:
    """The cut edge of the sea and its underside: lighter below the surface, dark at the bottom; v upwards."""
    h, w = 256, 1536
    v = ((np.arange(h) + 0.5) / h)[:, None]
    image = np.array([0.03, 0.10, 0.15]) + v[..., None] ** 1.4 * np.array([0.08, 0.27, 0.29]) * np.ones(
        (1, w, 1)
    )
    rays = np.tanh(t.noise(h, w, (2, 36), _rng(38))) * v + 0.6 * np.tanh(t.noise(h, w, (14, 80), _rng(39)))
    image = np.clip(image * (1.0 + 0.2 * rays)[..., None], 0.0, 1.0)
    return Surface("sea_body", image, roughness=0.2, coat=0.4, coat_roughness=0.1)


def cask() -> Surface:
    """Staves under iron hoops; u goes around, v upwards along the outline."""
    h, w = 192, 256
    image = furnishing.timber(h, w, (0.50, 0.34, 0.2), _rng(51), 0.35)
    staves = (((np.arange(w) + 0.5) / w * 14.0) % 1.0 < 0.12).astype(float)[None] * np.ones((h, 1))
    image = t.paint(image, staves, (0.14, 0.1, 0.07))
    for v in (0.24, 0.36, 0.54, 0.66):
        image = t.paint(image, t.band(h, w, v, v + 0.03), (0.13, 0.12, 0.12))
    return Surface("cask", image, roughness=0.6)


def boat() -> Surface:
    h, w = 192, 512
    boards = furnishing.planks(h, w, 8, 2.0, _rng(52), 0.16)
    image = furnishing.planked(
        (0.78, 0.74, 0.66), boards, furnishing.grain(h, w, _rng(53), 5, 40), (0.12, 0.14)
    )
    image = t.paint(image, t.band(h, w, 0.875, 0.99), (0.12, 0.24, 0.36))
    return Surface("boat", image, 1.0 - boards.seam, 0.003, roughness=0.5)
