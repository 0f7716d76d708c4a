"""Solid wood: year rings, fibres and pores cut by whatever surface lies in it."""

from __future__ import annotations

import numpy as np

from .solid import fractal, mix, noise, ramp, unit

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
