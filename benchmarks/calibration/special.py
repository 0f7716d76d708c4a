"""Films of one sort: still ones whose wall is plain, and plates of which one, or both, move by whole pixels."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.calibration.draw import Draw, FilmTruth, TrueVibration, kept_film
from benchmarks.calibration.film import FINE, Coding, Film, Layer, sliding, texture

_PLAIN_SEEDS, _LARGE_SEEDS = 50_000, 70_000  # of these films on
_CONTRAST = 0.0003, 0.05  # of a plain wall
_LARGE_PX, _SMALL_PX = (0.8, 4.0), (0.05, 0.1, 0.3)
_HALF_PX = 18, 52  # of a plate's side
_MOST = 240  # pictures


def make_plain_film(seed: int, folder: Path) -> FilmTruth:
    """Make a still film: shade, hardly any texture, and one to three textured boxes before it. Every line is false."""
    return kept_film(seed, folder, lambda: _plain(Draw(_PLAIN_SEEDS + seed)))


def make_large_film(seed: int, folder: Path) -> FilmTruth:
    """Make a film of two plates that move."""
    return kept_film(seed, folder, lambda: _large(seed))


def _plain(draw: Draw) -> tuple[np.ndarray, Coding, FilmTruth]:
    draw.frames = draw.truth.frames = min(draw.frames, _MOST)
    draw.duration = draw.frames / draw.fps
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
    film = Film(layers, draw.fps, draw.frames, draw.truth.noise, light, sway, [], draw.seed)
    return film.pictures(), draw.coding, draw.truth


def _large(seed: int) -> tuple[np.ndarray, Coding, FilmTruth]:
    draw = Draw(_LARGE_SEEDS + seed)
    rng, frames, width, height = draw.rng, min(draw.frames, _MOST), 320, 192
    plates, painters = [_plate(draw, frames, 80, True), _plate(draw, frames, 240, rng.random() < 0.5)], []
    for plate in plates:
        left, upper, right, lower = plate.region
        surface = texture(
            lower - upper + 32, right - left + 32, rng, rng.uniform(0.2, 0.45), 0.4, _sizes(rng)
        )
        painters.append(sliding(surface, ((left + right) // 2, height // 2), partial(_moved, plate)))
    wall = texture(height, width, rng, rng.uniform(0.15, 0.4), 0.35, [2.0, 6.0, 20.0])
    film = Film(
        [Layer(wall, None, [], 0.55)], draw.fps, frames, draw.truth.noise, painters=painters, seed=seed
    )
    truth = replace(draw.truth, width=width, height=height, frames=frames, vibrations=plates)
    bits = round(truth.bits_per_pixel * width * height * draw.fps)
    return film.pictures(), replace(draw.coding, bits_per_second=bits), truth


def _sizes(rng: np.random.Generator) -> list[float]:
    finest = rng.uniform(0.8, 2.5)
    return [finest, 3 * finest, 9.0]


def _plate(draw: Draw, frames: int, x: int, is_large: bool) -> TrueVibration:
    rng, half = draw.rng, int(draw.rng.integers(*_HALF_PX))
    size = float(np.exp(rng.uniform(*np.log(_LARGE_PX)))) if is_large else float(rng.choice(_SMALL_PX))
    angle, hz = rng.uniform(0, 2 * np.pi), float(rng.uniform(2.5 / frames, 0.45) * draw.fps)
    region = x - half, 96 - half, x + half, 96 + half
    return TrueVibration(
        hz, (size * np.cos(angle), size * np.sin(angle)), region, False, rng.uniform(0, 2 * np.pi)
    )


def _moved(plate: TrueVibration, time_s: float) -> np.ndarray:
    return plate.motion()(time_s) * np.array(plate.amplitude_px)
