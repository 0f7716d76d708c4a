"""Cloth and wood: damask on velvet, stripes, cord; grain in space, planks, pores."""

from dataclasses import dataclass

import numpy as np

from .. import textures as t
from ..scene import Rgb
from ..textures import diagonal
from .solid import fractal, mix, noise, ramp, step, unit

Tones = tuple[tuple[float, float, float], tuple[float, float, float]]  # darkest and brightest sRGB


def _flower(x: np.ndarray, y: np.ndarray, size: float) -> np.ndarray:
    """A rosette with leaves above and below, about the origin."""
    r, a = np.hypot(x, y) / size, np.arctan2(x, y)
    petals = step(r, 0.50 * (0.72 + 0.28 * np.cos(8.0 * a)), 0.44 * (0.72 + 0.28 * np.cos(8.0 * a)))
    eye = step(np.abs(r - 0.17), 0.06, 0.03)
    shape = petals * (1.0 - 0.9 * eye)
    for sign in (1.0, -1.0):
        for lean, reach, width in (
            (0.0, 0.92, 0.10),
            (0.55, 0.82, 0.11),
            (-0.55, 0.82, 0.11),
            (1.1, 0.66, 0.09),
            (-1.1, 0.66, 0.09),
        ):
            c, s = np.cos(lean), np.sin(lean)
            along, across = (sign * y * c + x * s) / size, (x * c - sign * y * s) / size
            t = np.clip((along - 0.45) / (reach - 0.45), 0.0, 1.0)
            leaf = width * np.maximum(np.sin(np.pi * t), 0.0) ** 0.7
            body = step(np.abs(across), leaf, 0.75 * leaf - 0.005) * (t > 0.0) * (t < 1.0)
            shape = np.maximum(shape, body * (1.0 - 0.8 * step(np.abs(across), 0.018, 0.008)))
    return shape


def damask(a: np.ndarray, b: np.ndarray, period: tuple[float, float]) -> np.ndarray:
    """Mask [H, W] in 0..1 of the ornament at cloth coordinates a, b (scene units); b runs up the cloth."""
    x, y = a / period[0], b / period[1]
    wave = np.cos(2.0 * np.pi * x) + np.cos(2.0 * np.pi * y) + 0.22 * np.cos(4.0 * np.pi * y)
    mask = step(np.abs(wave), 0.26, 0.17) * (1.0 - step(np.abs(wave), 0.085, 0.05))
    beads = step(np.abs(wave) + 0.16 * np.abs(np.sin(24.0 * np.pi * y)), 0.07, 0.03)
    mask = np.maximum(mask, beads)
    size = 0.40 * min(period)
    for shift in (0.0, 0.5):
        u, v = (x + shift) % 1.0 - 0.5, (y + shift) % 1.0 - 0.5
        mask = np.maximum(mask, _flower(u * period[0], v * period[1], size))
    return mask


def velvet(
    points: np.ndarray,  # [H, W, 3] where the texels lie: the nap varies in space
    ornament: np.ndarray,  # [H, W] mask
    ground: Tones,
    figure: Tones,
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture [H, W, 3], relief and roughness [H, W]: pile with a nap, the ornament raised in shiny thread."""
    nap = fractal(points, 3.0, 3, seed)
    fine = noise(points, 60.0, seed + 1)
    pile = ramp(0.5 + 0.28 * nap + 0.13 * fine, [(0.0, ground[0]), (1.0, ground[1])])
    thread = ramp(0.55 + 0.2 * nap + 0.2 * fine, [(0.0, figure[0]), (1.0, figure[1])])
    image = mix(pile, thread, ornament)
    relief = unit(0.35 + 0.06 * fine + 0.05 * nap + 0.35 * ornament)
    return unit(image), relief, unit(0.85 - 0.35 * ornament)


def cord(
    height: int, width: int, turns: float, tones: Tones, other: Tones, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Twisted two-coloured cord for a swept tube (u around, v along): picture and relief."""
    v = ((np.arange(height) + 0.5) / height)[:, None]
    u = ((np.arange(width) + 0.5) / width)[None]
    phase = (turns * v + 2.0 * u) % 1.0
    ridge = np.sqrt(np.abs(np.sin(2.0 * np.pi * phase)))
    line = np.stack(np.broadcast_arrays(600.0 * v, 3.0 * u, 0.0 * u), -1)
    grain = noise(line, 1.0, seed)
    first = ramp(ridge + 0.15 * grain, [(0.0, tones[0]), (1.0, tones[1])])
    second = ramp(ridge + 0.15 * grain, [(0.0, other[0]), (1.0, other[1])])
    return unit(mix(first, second, (phase > 0.5).astype(float))), ridge


def laid(
    height: int, width: int, colour: Rgb, rng: np.random.Generator, turns: float = 6.0
) -> tuple[np.ndarray, np.ndarray]:
    """Three-strand rope: (picture [H, W, 3], height [H, W]); tiles along v."""
    strands = np.sqrt(np.abs(2.0 * diagonal(height, width, turns, 1) - 1.0))
    spots = np.tanh(t.noise(height, width, (8, 3), rng))
    gain = (0.45 + 0.6 * strands) * (1.0 + 0.25 * spots)
    return np.clip(np.array(colour) * gain[..., None], 0.0, 1.0), strands


def canvas(
    height: int, width: int, colour: Rgb, rng: np.random.Generator, seams: int, wrinkles: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Old sailcloth, seams along u every 1/`seams` of v: (picture [H, W, 3], height of the wrinkles [H, W])."""
    folds = t.noise(height, width, wrinkles, rng)
    ridges = 1.0 - np.abs(np.tanh(1.2 * folds))
    weave = rng.standard_normal((height, width))
    stains = np.tanh(t.noise(height, width, (5, 3), rng))
    v = (np.arange(height) + 0.5) / height * seams
    near = np.abs(v % 1.0 - 0.5)
    seam = ((near < 0.05) | (np.abs(near - 0.1) < 0.012)).astype(float)[:, None]
    gain = (1.0 + 0.10 * stains + 0.035 * weave) * (0.74 + 0.3 * ridges) * (1.0 - 0.32 * seam)
    tint = np.array([1.0, 0.985, 0.95]) ** (1.0 + stains[..., None])
    return np.clip(np.array(colour) * gain[..., None] * tint, 0.0, 1.0), np.clip(
        0.8 * ridges + 0.2 * seam, 0, 1
    )


@dataclass(frozen=True)
class Planks:
    """The layout of planks in a picture [H, W]; they run along u."""

    tone: np.ndarray  # [H, W] one random value in −1..1 per plank
    seam: np.ndarray  # [H, W] 1 in the gaps between planks and at their butts
    nails: np.ndarray  # [H, W] 1 on the heads of nails


def planks(
    height: int, width: int, rows: int, per_row: float, rng: np.random.Generator, gap: float = 0.1
) -> Planks:
    """`rows` strakes of planks, about `per_row` to a row, butts staggered; `gap` of a plank's width is seam."""
    v = (np.arange(height) + 0.5) / height * rows
    u = (np.arange(width) + 0.5) / width
    row = v.astype(int)
    start = (0.37 * np.arange(rows) + rng.uniform(-0.08, 0.08, rows)) % 1.0
    place = u[None] * per_row + start[row][:, None]
    number = np.floor(place).astype(int)
    tones = rng.uniform(-1.0, 1.0, (rows, int(np.ceil(per_row)) + 2))
    across, along = v % 1.0, place % 1.0
    px = height / rows  # pixels per plank width
    butt = np.minimum(along, 1.0 - along) / per_row * width < 0.5 * gap * px
    seam = (np.minimum(across, 1.0 - across) < 0.5 * gap)[:, None] | butt
    near = np.abs(np.minimum(along, 1.0 - along) / per_row * width - 0.35 * px) < 0.09 * px
    nails = near & (np.abs(np.abs(across - 0.5) - 0.22) < 0.09)[:, None]
    return Planks(tones[row[:, None], number], seam.astype(float), nails.astype(float))


def grain(height: int, width: int, rng: np.random.Generator, along: int, across: int) -> np.ndarray:
    """Long fibres along u, [H, W] about ±1: waves per picture along the fibre and across it."""
    fine = t.noise(height, width, (across, along), rng)
    coarse = t.noise(height, width, (max(across // 4, 2), max(along // 2, 1)), rng)
    return np.tanh(0.6 * fine + 0.4 * coarse)


def planked(
    colour: Rgb,
    boards: Planks,
    fibres: np.ndarray,
    contrast: tuple[float, float] = (0.22, 0.22),
    seam: Rgb = (0.1, 0.08, 0.06),
) -> np.ndarray:
    """Picture [H, W, 3] of planks: `contrast` between planks and of the grain."""
    gain = (1.0 + contrast[0] * boards.tone) * (1.0 + contrast[1] * fibres)
    warm = 1.0 - np.array([0.0, 0.04, 0.1]) * boards.tone[..., None]  # some planks redder than others
    image = np.array(colour) * gain[..., None] * warm
    dark = np.maximum(boards.seam, 0.7 * boards.nails)[..., None]
    return np.clip(image * (1.0 - dark) + np.array(seam) * dark, 0.0, 1.0)


def timber(
    height: int, width: int, colour: Rgb, rng: np.random.Generator, contrast: float = 0.3
) -> np.ndarray:
    """Plain wood whose fibres run along v (spars are swept along v): picture [H, W, 3]."""
    fibres = grain(width, height, rng, 6, 26).T
    streak = np.tanh(t.noise(height, width, (4, 8), rng))
    gain = 1.0 + contrast * (0.75 * fibres + 0.35 * streak)
    return np.clip(np.array(colour) * gain[..., None], 0.0, 1.0)


Stops = tuple[tuple[float, tuple[float, float, float]], ...]
HONEY: Stops = (
    (0.0, (0.36, 0.17, 0.06)),
    (0.45, (0.60, 0.34, 0.13)),
    (0.8, (0.76, 0.49, 0.22)),
    (1.0, (0.85, 0.62, 0.33)),
)
WALNUT: Stops = ((0.0, (0.16, 0.08, 0.04)), (0.5, (0.36, 0.2, 0.11)), (1.0, (0.56, 0.36, 0.2)))


def wood(
    points: np.ndarray, rings: float, stops: Stops, seed: int, axis: int = 2
) -> tuple[np.ndarray, np.ndarray]:
    """Picture [H, W, 3] and pores [H, W] at points [H, W, 3]; `rings` per scene unit, trunk along `axis`."""
    order = [k for k in range(3) if k != axis] + [axis]
    p = np.asarray(points, np.float32)[..., order]
    bend = 0.11 * noise(p, [1.6, 1.6, 0.5], seed)
    distance = np.hypot(p[..., 0] + 0.31 + bend, p[..., 1] - 0.17 + 0.6 * bend)
    phase = (distance * rings) % 1.0
    ring = phase**2.2 * (1.0 - np.clip((phase - 0.9) / 0.1, 0.0, 1.0))
    fibre = fractal(p, [60.0, 60.0, 4.0], 2, seed + 1)
    streak = fractal(p, [9.0, 9.0, 0.7], 2, seed + 2)
    pores = unit(1.6 * noise(p, [130.0, 130.0, 9.0], seed + 3) - 1.4)
    image = ramp(0.72 - 0.42 * ring + 0.10 * fibre + 0.13 * streak, stops)
    return unit(mix(image, np.asarray(stops[0][1]) * 0.6, 0.6 * pores)), unit(pores + 0.3 * ring)
