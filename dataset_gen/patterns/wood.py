"""Wood: planks with butts, grain, nails and caulked seams; straight grain for timbers and spars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import textures as t
from ..scene import Rgb
from .solid import fractal, mix, noise, ramp, unit


@dataclass(frozen=True)
class Planks:
    """Where planks lie in a picture [H, W]; they run along u."""

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
