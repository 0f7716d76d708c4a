"""Still films whose wall is plain: shade, hardly any texture, and one to three textured boxes before it."""

from pathlib import Path

import numpy as np

from benchmarks.calibration.draw import Draw, Truth, kept_film
from benchmarks.calibration.film import FINE, Coding, Film, Layer, texture

_SEEDS = 50_000  # of these films on
_CONTRAST = 0.0003, 0.05  # of the wall
_MOST = 240  # pictures


def make_plain_film(seed: int, folder: Path) -> Truth:
    """Nothing vibrates: every line is false."""
    return kept_film(seed, folder, lambda: _drawn(seed))


def _drawn(seed: int) -> tuple[Film, Coding, Truth]:
    draw = Draw(_SEEDS + seed)
    draw.frames = draw.truth.frames = min(draw.frames, _MOST)
    draw.duration = draw.frames / draw.fps
    return _film(draw), draw.coding, draw.truth


def _film(draw: Draw) -> Film:
    rng, w, h = draw.rng, draw.width, draw.height
    contrast = float(np.exp(rng.uniform(*np.log(_CONTRAST))))
    sizes = rng.uniform(0.08, 0.5), np.array([1.3, 3.0, 9.0]) * rng.uniform(0.9, 2.2)
    wall = texture(h, w, rng, contrast, *sizes)
    y, x = np.mgrid[: h * FINE, : w * FINE] / FINE
    shade = [rng.uniform(-0.3, 0.3) * (share - 0.5) for share in (x / w, y / h)]
    layers = [Layer(wall * (1 + shade[0] + shade[1]), None, [], draw.blur)]
    boxes = [draw.box() for _ in range(rng.integers(1, 4))]
    layers += [Layer(draw.surface(), box, [], draw.blur) for box in boxes]
    light, sway = draw.light(), draw.sway()
    return Film(layers, draw.fps, draw.frames, draw.truth.noise, light, sway, [], draw.seed)
