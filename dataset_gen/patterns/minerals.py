"""Stone and metal painted in space: marble, hammered gold, brushed steel, patinated copper, fired clay.

Points [..., 3] lie on the unit ball. Each gives a picture [..., 3], a relief [...] and a roughness [...], all in 0..1.
"""

from __future__ import annotations

import numpy as np

from .solid import cells, fractal, mix, noise, ramp, spots, step, unit

Painted = tuple[np.ndarray, np.ndarray, np.ndarray]


def marble(points: np.ndarray, seed: int) -> Painted:
    """White stone with grey veins of two sizes and rusty breath along them."""
    warp = np.stack([fractal(points, 1.3, 3, seed + k) for k in range(3)], -1)
    broad = np.abs(fractal(points + 0.16 * warp, 1.1, 2, seed + 3))
    thin = np.abs(fractal(points + 0.14 * warp, 2.3, 1, seed + 4))
    cloud = fractal(points, 2.4, 3, seed + 5)
    image = ramp(0.6 + 0.22 * cloud, [(0.0, (0.74, 0.75, 0.77)), (1.0, (0.96, 0.95, 0.93))])
    image = mix(image, (0.70, 0.55, 0.38), 0.55 * step(broad, 0.38, 0.05))
    image = mix(image, (0.17, 0.18, 0.21), 0.9 * step(broad, 0.16, 0.03))
    image = mix(image, (0.33, 0.34, 0.38), 0.6 * step(thin, 0.13, 0.02))
    return unit(image), unit(0.5 + 0.04 * cloud), np.full(cloud.shape, 0.16)


def hammered(points: np.ndarray, seed: int) -> Painted:
    """Gold beaten with a round hammer; darker in the joints of the blows."""
    near, second, label = cells(points, 4.2, seed, 0.9)
    joint = step(second - near, 0.16, 0.02)
    fine = fractal(points, 14.0, 2, seed)
    image = ramp(
        label + 0.16 * fine, [(0.0, (0.80, 0.56, 0.18)), (0.6, (0.95, 0.74, 0.30)), (1.1, (1.0, 0.87, 0.52))]
    )
    image = mix(image, (0.42, 0.24, 0.06), 0.65 * joint)
    return unit(image), unit(near**2 + 0.03 * fine), unit(0.22 + 0.05 * fine + 0.3 * joint)


def brushed(points: np.ndarray, seed: int) -> Painted:
    """Steel turned on a lathe about z: rings of fine scratches, a few engraved lines, fingermarks."""
    scratch = fractal(points, [0.5, 0.5, 42.0], 2, seed)
    smear = fractal(points, 2.6, 3, seed + 1)
    line = step(np.abs((points[..., 2] * 4.0) % 1.0 - 0.5), 0.07, 0.04)
    image = ramp(0.5 + 0.24 * scratch + 0.1 * smear, [(0.0, (0.40, 0.42, 0.45)), (1.0, (0.92, 0.92, 0.92))])
    image = mix(image, (0.12, 0.13, 0.15), 0.85 * line)
    return unit(image), unit(0.55 + 0.1 * scratch - 0.4 * line), unit(0.30 + 0.05 * scratch + 0.07 * smear)


def patina(points: np.ndarray, seed: int) -> Painted:
    """Copper with verdigris grown over it in islands."""
    grown = fractal(points, 1.9, 5, seed)
    fine = fractal(points, 16.0, 2, seed + 1)
    copper = ramp(0.5 + 0.25 * fine + 0.15 * grown, [(0.0, (0.50, 0.22, 0.11)), (1.0, (0.93, 0.58, 0.38))])
    green = ramp(0.5 + 0.3 * fine, [(0.0, (0.15, 0.42, 0.37)), (1.0, (0.58, 0.83, 0.72))])
    over = step(grown + 0.12 * fine, 0.05, 0.35)
    edge = step(np.abs(grown + 0.12 * fine - 0.08), 0.14, 0.03)
    image = mix(mix(copper, green, over), (0.20, 0.10, 0.07), 0.6 * edge)
    return unit(image), unit(0.4 + 0.25 * over + 0.08 * fine), unit(0.32 + 0.55 * over)


def clay(points: np.ndarray, seed: int) -> Painted:
    """Rough terracotta: pits, grog, a thrower's grooves."""
    pit, _ = spots(points, 5.5, seed)
    grog, label = spots(points, 13.0, seed + 1)
    rough = fractal(points, 3.2, 4, seed)
    groove = np.sin(38.0 * points[..., 2] + 1.5 * noise(points, 1.2, seed + 2))
    image = ramp(
        0.5 + 0.26 * rough + 0.09 * groove,
        [(0.0, (0.46, 0.2, 0.12)), (0.6, (0.74, 0.4, 0.25)), (1.0, (0.86, 0.58, 0.42))],
    )
    image = mix(
        image,
        ramp(label, [(0.0, (0.25, 0.11, 0.08)), (1.0, (0.95, 0.82, 0.68))]),
        0.8 * step(grog, 0.24, 0.15),
    )
    hole = step(pit, 0.2, 0.09)
    image = mix(image, (0.22, 0.09, 0.06), 0.7 * hole)
    return unit(image), unit(0.6 + 0.1 * rough + 0.1 * groove - 0.5 * hole), np.full(rough.shape, 0.95)
