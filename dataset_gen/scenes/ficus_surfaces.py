"""Surfaces of the ficus: one picture for all foliage (leaf faces in strips, bark below them), clay, soil, stones."""

import numpy as np

from .. import textures as t
from ..scene import Rgb, Surface
from ..textures import noise

# Strips of the foliage picture from v = 0: upper and lower face of each kind of leaf, then bark.
KINDS = 4
STRIPS = 2 * KINDS + 1
BARK = 2 * KINDS
_STRIP = 112  # pixels across a leaf
_WIDTH = 320  # pixels along it

# Upper face, lower face and veins of mature, ordinary, young and yellowing leaves.
_GREENS = (
    ((0.11, 0.235, 0.075), (0.29, 0.39, 0.19), (0.40, 0.49, 0.24)),
    ((0.155, 0.31, 0.085), (0.33, 0.44, 0.22), (0.48, 0.57, 0.28)),
    ((0.26, 0.44, 0.11), (0.40, 0.50, 0.26), (0.55, 0.63, 0.34)),
    ((0.33, 0.40, 0.11), (0.46, 0.48, 0.26), (0.64, 0.62, 0.34)),
)


def blade(
    height: int, width: int, colour: Rgb, veins: Rgb, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """One face of a leaf: u from base to tip, v across, midrib in the middle: (picture [H, W, 3], relief [H, W])."""
    u = ((np.arange(width) + 0.5) / width)[None]
    across = ((np.arange(height) + 0.5) / height * 2.0 - 1.0)[:, None]
    c = np.abs(across)
    midrib = np.exp(-((c / (0.075 * (1.15 - u))) ** 2))
    along = (u - 0.34 * c) * 13.0 + 0.25 * np.sign(across)
    distance = np.abs(along % 1.0 - 0.5)
    lateral = np.exp(-((distance / 0.085) ** 2)) * (1.0 - 0.75 * c) * (u > 0.03)
    fine = np.exp(-((np.abs((along * 4.0) % 1.0 - 0.5) / 0.2) ** 2)) * 0.25 * (1.0 - c)
    web = np.clip(midrib + 0.75 * lateral + fine, 0.0, 1.0)[..., None]
    mottle = np.tanh(0.7 * noise(height, width, (5, 8), rng) + 0.5 * noise(height, width, (16, 30), rng))
    gain = (1.0 + 0.22 * mottle) * (0.86 + 0.3 * distance * (1.0 - 0.5 * c))
    margin = np.clip((c - 0.80) / 0.14, 0.0, 1.0)[..., None] * np.ones((1, width, 1))
    image = np.array(colour) * gain[..., None]
    image = image * (1.0 - 0.55 * margin) + 0.55 * margin * np.array(veins)
    image = image * (1.0 - 0.8 * web) + 0.8 * web * np.array(veins)
    tip = np.clip((u - 0.93) / 0.07, 0.0, 1.0)[..., None]  # often a little dry
    image = image * (1.0 - 0.5 * tip) + 0.5 * tip * np.array([0.5, 0.4, 0.16])
    return np.clip(image, 0.0, 1.0), np.clip(0.75 - 0.6 * web[..., 0] + 0.04 * mottle, 0.0, 1.0)


def barked(height: int, width: int, colour: Rgb, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Grey bark; the axis runs along u: long fissures, cross rings, pale lenticels: (picture, relief)."""
    fissures = np.tanh(noise(height, width, (12, 9), rng) + 0.5 * noise(height, width, (26, 20), rng))
    rings = np.tanh(1.4 * noise(height, width, (3, 40), rng))
    spots = np.clip(noise(height, width, (22, 52), rng) - 1.35, 0.0, 0.8)
    moss = np.clip(noise(height, width, (4, 4), rng) - 0.5, 0.0, 1.0)[..., None]
    gain = 1.0 + 0.3 * fissures + 0.16 * rings
    image = np.array(colour) * gain[..., None] + spots[..., None] * np.array([0.35, 0.31, 0.25])
    image = image * (1.0 - 0.35 * moss) + 0.35 * moss * np.array([0.30, 0.33, 0.19])
    return np.clip(image, 0.0, 1.0), np.clip(0.5 + 0.28 * fissures + 0.15 * rings, 0.0, 1.0)


def earth(size: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Potting soil with bark chips and white grains: (picture [H, W, 3], relief [H, W])."""
    crumbs = np.tanh(noise(size, size, (26, 26), rng) + 0.7 * noise(size, size, (60, 60), rng))
    chips = np.clip(2.0 * noise(size, size, (18, 34), rng) - 2.4, 0.0, 1.0)[..., None]
    grains = np.clip(3.0 * noise(size, size, (64, 64), rng) - 6.6, 0.0, 1.0)[..., None]
    image = np.array([0.20, 0.145, 0.10]) * (1.0 + 0.5 * crumbs[..., None])
    image = image * (1.0 - chips) + chips * np.array([0.42, 0.26, 0.15])
    image = image * (1.0 - grains) + grains * np.array([0.8, 0.78, 0.72])
    return np.clip(image, 0.0, 1.0), np.clip(0.5 + 0.25 * crumbs + 0.2 * chips[..., 0], 0.0, 1.0)


def running_glaze(
    height: int, width: int, body: Rgb, over: Rgb, edge: float, reach: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A second glaze poured over the upper part: (picture [H, W, 3], mask of the second glaze [H, W]).

    It starts above v = `edge` and runs down in tongues as long as `reach`.
    """
    v = ((np.arange(height) + 0.5) / height)[:, None]
    tongues, small = (noise(8, width, (1, waves), rng)[:1] for waves in (13, 34))
    line = edge - reach * (0.5 + 0.36 * np.tanh(tongues) + 0.08 * np.tanh(small))
    mask = np.clip((v - line) / 0.012, 0.0, 1.0)
    speck = np.clip(2.5 * noise(height, width, (60, 150), rng) - 4.2, 0.0, 1.0)
    cloud = np.tanh(0.7 * noise(height, width, (6, 14), rng) + 0.4 * noise(height, width, (24, 60), rng))
    under = np.array(body) * (1.0 + 0.22 * cloud)[..., None]
    upper = np.array(over) * (1.0 + 0.16 * cloud)[..., None]
    image = under * (1.0 - mask[..., None]) + upper * mask[..., None]
    rim = np.exp(-(((v - line - 0.004) / 0.012) ** 2))[..., None]  # the bead along the lower edge
    image = image * (1.0 - 0.45 * rim) + 0.45 * rim * (0.5 * np.array(over) + np.array([0.12, 0.1, 0.05]))
    image = image * (1.0 - 0.7 * speck[..., None]) + 0.7 * speck[..., None] * np.array([0.09, 0.07, 0.05])
    return np.clip(image, 0.0, 1.0), mask


def terracotta(height: int, width: int, rng: np.random.Generator) -> np.ndarray:
    """Fired clay with turning lines, lime bloom and stains."""
    rings = noise(height, width, (40, 1), rng)
    grain = noise(height, width, (60, 90), rng)
    bloom = np.clip(noise(height, width, (5, 10), rng) - 0.3, 0.0, 1.0)[..., None]
    image = np.array([0.62, 0.33, 0.21]) * (1.0 + 0.07 * rings + 0.12 * np.tanh(grain))[..., None]
    return np.clip(image * (1.0 - 0.3 * bloom) + 0.3 * bloom * np.array([0.82, 0.74, 0.66]), 0.0, 1.0)


_rng = t.seeded(2032)


def foliage_strips() -> Surface:
    colour, relief, rough = [], [], []
    for kind, (upper, lower, veins) in enumerate(_GREENS):
        for side, green in enumerate((upper, lower)):
            image, height = blade(_STRIP, _WIDTH, green, veins, _rng(10 * kind + side))
            colour.append(image)
            relief.append(height)
            rough.append(np.full((_STRIP, _WIDTH), 0.36 if side == 0 else 0.6))
    image, height = barked(_STRIP, _WIDTH, (0.34, 0.28, 0.2), _rng(90))
    colour.append(image)
    relief.append(height)
    rough.append(np.full((_STRIP, _WIDTH), 0.85))
    return Surface(
        "foliage", np.concatenate(colour), np.concatenate(relief), 0.003, roughness=np.concatenate(rough),
    )  # fmt: skip


def bark() -> Surface:
    """The stems; they are swept, so the axis runs along v."""
    image, height = barked(160, 1024, (0.42, 0.35, 0.27), _rng(91))
    return Surface("bark", image.transpose(1, 0, 2).copy(), height.T.copy(), 0.008, roughness=0.85)


def pot() -> Surface:
    """Dark glaze, a warmer one run over it from the rim, an incised band; v runs up the wall and into the pot.

    Along the outline the foot ends at v = 0.26, the wall at 0.71, the rim at 0.83.
    """
    h, w = 640, 1280
    image, over = running_glaze(h, w, (0.17, 0.115, 0.09), (0.43, 0.27, 0.155), 0.62, 0.2, _rng(92))
    relief = 0.7 + 0.2 * over
    for v in (0.555, 0.645):
        line = t.band(h, w, v, v + 0.008)
        image, relief = t.paint(image, line, (0.10, 0.06, 0.04)), relief - 0.5 * line
    zone = t.band(h, w, 0.568, 0.640)
    waves = zone * (np.abs(t.diagonal(h, w, 14.0, 26) - t.diagonal(h, w, -14.0, 26)) < 0.2)
    image, relief = t.paint(image, 0.85 * waves, (0.66, 0.52, 0.34)), relief - 0.5 * waves
    inside = t.band(h, w, 0.85, 1.0)
    image = t.paint(image, 0.8 * inside, (0.22, 0.15, 0.11))
    rough = 0.32 + 0.2 * (1.0 - over)
    return Surface(
        "pot", np.clip(image, 0, 1), np.clip(relief, 0, 1), 0.004, roughness=rough, coat=0.4,
        coat_roughness=0.15,
    )  # fmt: skip


def saucer() -> Surface:
    return Surface("saucer", terracotta(256, 1024, _rng(93)), roughness=0.8)


def soil() -> Surface:
    image, height = earth(512, _rng(94))
    return Surface("soil", image, height, 0.012, roughness=0.95)


def pebbles() -> Surface:
    h, w = 512, 512
    tone = np.tanh(t.noise(h, w, (7, 7), _rng(95)))[..., None]
    warm = np.tanh(t.noise(h, w, (7, 7), _rng(96)))[..., None]
    image = np.array([0.56, 0.53, 0.48]) * (1.0 + 0.5 * tone) + warm * np.array([0.07, 0.0, -0.06])
    veins = np.clip(1.0 - np.abs(t.noise(h, w, (16, 24), _rng(97))) * 9.0, 0.0, 1.0)
    image = t.paint(np.clip(image, 0, 1), 0.5 * veins, (0.85, 0.83, 0.78))
    return Surface("pebbles", t.speckle(image, _rng(98), 0.3, (60, 60)), roughness=0.6)
