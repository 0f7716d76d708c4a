"""Surfaces of the ficus: one picture for all foliage (leaf faces in strips, bark below them), clay, soil, stones."""

from __future__ import annotations

import numpy as np

from .. import textures as t
from ..patterns import ceramic, foliage
from ..scene import Surface

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

_rng = t.seeded(2032)


def foliage_strips() -> Surface:
    """Leaves, stalks and twigs."""
    colour, relief, rough = [], [], []
    for kind, (upper, lower, veins) in enumerate(_GREENS):
        for side, green in enumerate((upper, lower)):
            image, height = foliage.blade(_STRIP, _WIDTH, green, veins, _rng(10 * kind + side))
            colour.append(image)
            relief.append(height)
            rough.append(np.full((_STRIP, _WIDTH), 0.36 if side == 0 else 0.6))
    image, height = foliage.bark(_STRIP, _WIDTH, (0.34, 0.28, 0.2), _rng(90))
    colour.append(image)
    relief.append(height)
    rough.append(np.full((_STRIP, _WIDTH), 0.85))
    return Surface(
        "foliage", np.concatenate(colour), np.concatenate(relief), 0.003, roughness=np.concatenate(rough),
    )  # fmt: skip


def bark() -> Surface:
    """The stems; they are swept, so the axis runs along v."""
    image, height = foliage.bark(160, 1024, (0.42, 0.35, 0.27), _rng(91))
    return Surface("bark", image.transpose(1, 0, 2).copy(), height.T.copy(), 0.008, roughness=0.85)


def pot() -> Surface:
    """Dark glaze, a warmer one run over it from the rim, an incised band; v runs up the wall and into the pot.

    Along the outline the foot ends at v = 0.26, the wall at 0.71, the rim at 0.83.
    """
    h, w = 640, 1280
    image, over = ceramic.running_glaze(h, w, (0.17, 0.115, 0.09), (0.43, 0.27, 0.155), 0.62, 0.2, _rng(92))
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
    """Bare clay."""
    return Surface("saucer", ceramic.terracotta(256, 1024, _rng(93)), roughness=0.8)


def soil() -> Surface:
    """Potting soil, seen from above."""
    image, height = foliage.soil(512, _rng(94))
    return Surface("soil", image, height, 0.012, roughness=0.95)


def pebbles() -> Surface:
    """River stones of many greys, whites and browns: the picture is a patchwork, each stone takes a piece."""
    h, w = 512, 512
    tone = np.tanh(t.noise(h, w, (7, 7), _rng(95)))[..., None]
    warm = np.tanh(t.noise(h, w, (7, 7), _rng(96)))[..., None]
    image = np.array([0.56, 0.53, 0.48]) * (1.0 + 0.5 * tone) + warm * np.array([0.07, 0.0, -0.06])
    veins = np.clip(1.0 - np.abs(t.noise(h, w, (16, 24), _rng(97))) * 9.0, 0.0, 1.0)
    image = t.paint(np.clip(image, 0, 1), 0.5 * veins, (0.85, 0.83, 0.78))
    return Surface("pebbles", t.speckle(image, _rng(98), 0.3, (60, 60)), roughness=0.6)
