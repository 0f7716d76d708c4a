"""Surfaces of the toy bulldozer: worn plastic in its colours, lettered studs, prints, chrome, lenses."""

from __future__ import annotations

from functools import cache

import numpy as np

from .. import textures as t
from ..patterns import plastic as p
from ..scene import Surface
from ..shapes.bricks import ATLAS

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

_rng = t.seeded(2025, 100)


@cache
def _worn(colour: p.Rgb) -> tuple[np.ndarray, np.ndarray]:
    """One texture per colour; dark plastic needs more contrast to show anything."""
    number, dark = 10 + list(_COLOURS).index(colour), max(colour) < 0.4
    size = 768 if colour in (_YELLOW, _SAND) else 512
    mottle, grain = (0.2, 0.3) if dark else (0.05, 0.1)
    return p.moulded(colour, _rng(number), size, mottle, grain, 0.55, 0.3 if dark else 0.16)


def _plastic(name: str) -> Surface:
    image, rough = _worn(_PLASTIC[name])
    return Surface(name, image, roughness=rough, ior=1.53)


def _studs(name: str) -> Surface:
    image, relief = _tops(_PLASTIC[name])
    return Surface(f"{name}_studs", image, relief, 0.003, roughness=0.38, ior=1.53)


@cache
def _tops(colour: p.Rgb) -> tuple[np.ndarray, np.ndarray]:
    return p.stud_tops(colour, _rng(20 + list(_COLOURS).index(colour)), ATLAS)


def _label() -> Surface:
    """Printed tile: name, number, a black line, warning stripes at both ends."""
    h, w = 192, 1152
    image = t.flat(h, w, (0.93, 0.73, 0.1))
    stripes = p.hazard(h, 144, _rng(1), 3)
    image[:, :144], image[:, -144:] = stripes, stripes[:, ::-1]
    ink = t.stamp(np.zeros((h, w)), t.lettering("TG4M 2025", 14), 0.53, 0.5)
    image = t.paint(image, ink, (0.08, 0.08, 0.09))
    line = t.band(h, w, 0.06, 0.11) + t.band(h, w, 0.89, 0.94)
    line[:, :160], line[:, -160:] = 0.0, 0.0
    image = t.speckle(t.paint(image, line, _RED), _rng(2), 0.12, (20, 120))
    return Surface("label", image, roughness=0.35, coat=0.3)


def _stripes() -> Surface:
    return Surface("stripes", p.hazard(160, 512, _rng(3), 5), roughness=0.4)


def _chrome(name: str) -> Surface:
    """Brushed metal with stains and rings, so that its own motion shows between the reflections."""
    image = t.speckle(t.flat(256, 256, (0.74, 0.74, 0.75)), _rng(4), 0.22, (18, 10))
    return Surface(name, image, metallic=0.85, roughness=0.32)


def _lens(name: str, colour: p.Rgb) -> Surface:
    """A moulded lens: a lattice under a clear coat, no true glass."""
    image = t.paint(t.flat(128, 128, colour), 0.35 * t.knurl(128, 128, 12.0, 12), (1.0, 1.0, 1.0))
    image = t.speckle(image, _rng(5), 0.12, (20, 20))
    return Surface(name, image, roughness=0.25, coat=0.6)


def surfaces() -> dict[str, Surface]:
    """Surface by part name."""
    out = {name: _plastic(name) for name in _PLASTIC}
    out |= {f"{name}_studs": _studs(name) for name in _STUDS}
    out |= {"label": _label(), "stripes": _stripes(), "chrome": _chrome("chrome"), "rods": _chrome("rods")}
    out |= {
        "lens": _lens("lens", (0.93, 0.92, 0.84)),
        "cab_lens": _lens("cab_lens", (0.93, 0.92, 0.84)),
        "beacon": _lens("beacon", (0.95, 0.45, 0.05)),
    }
    return out
