"""Stuffs painted in space: marble, hammered gold, brushed steel, patina, clay, hides, flake paint, swirled glass.

Points [..., 3] lie on the unit ball. Each gives a picture [..., 3], a relief [...] and a roughness [...], all in 0..1.
"""

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


def leopard(points: np.ndarray, seed: int) -> Painted:
    """Broken rosettes on tawny fur."""
    warp = np.stack([noise(points, 2.4, seed + k) for k in range(3)], -1)
    near, second, label = cells(points + 0.05 * warp, 3.9, seed, 0.6)
    torn = fractal(points, 3.4, 3, seed + 3)
    hair = fractal(points, [22.0, 22.0, 6.0], 2, seed + 4)
    size = 0.30 + 0.10 * label
    ring = step(np.abs(near - size), 0.15, 0.09) * step(torn, -1.0, -0.7) * step(second - near, 0.02, 0.1)
    inside = step(near, size, size - 0.08)
    image = ramp(0.5 + 0.2 * torn + 0.16 * hair, [(0.0, (0.70, 0.47, 0.2)), (1.0, (0.95, 0.78, 0.47))])
    image = mix(image, (0.58, 0.33, 0.11), 0.7 * inside)
    image = mix(image, ramp(hair, [(-1.5, (0.04, 0.03, 0.02)), (1.5, (0.2, 0.12, 0.07))]), ring)
    return unit(image), unit(0.5 + 0.16 * hair), np.full(hair.shape, 0.7)


def leather(points: np.ndarray, seed: int) -> Painted:
    """Grained brown hide of four panels; a light thread stitches the seams."""
    near, second, label = cells(points, 10.0, seed)
    crease = step(second - near, 0.2, 0.02)
    worn = fractal(points, 1.7, 4, seed)
    image = ramp(
        0.45 + 0.2 * worn + 0.3 * (label - 0.5),
        [(0.0, (0.26, 0.1, 0.05)), (0.6, (0.54, 0.27, 0.13)), (1.0, (0.74, 0.45, 0.25))],
    )
    image = mix(image, (0.13, 0.05, 0.03), 0.7 * crease)
    seam, thread = np.zeros_like(worn), np.zeros_like(worn)
    for axis, other in ((0, 1), (1, 0)):
        away = np.abs(points[..., axis])
        turn = np.arctan2(points[..., 2], points[..., other]) * 26.0 / (2.0 * np.pi)
        seam = np.maximum(seam, step(away, 0.024, 0.012))
        dash = step(np.abs(turn % 1.0 - 0.5), 0.34, 0.28) * step(np.abs(away - 0.065), 0.021, 0.014)
        thread = np.maximum(thread, dash)
    image = mix(mix(image, (0.08, 0.03, 0.02), 0.9 * seam), (0.93, 0.82, 0.58), thread)
    return unit(image), unit(0.5 + 0.3 * (1.0 - crease) - 0.5 * seam + 0.3 * thread), unit(0.5 - 0.06 * worn)


def flakes(points: np.ndarray, seed: int) -> Painted:
    """Deep red lacquer full of glinting flakes, with two cream racing stripes."""
    large, label = spots(points, 17.0, seed)
    small, other = spots(points, 34.0, seed + 1)
    depth = fractal(points, 2.2, 3, seed)
    image = ramp(0.5 + 0.25 * depth, [(0.0, (0.30, 0.01, 0.03)), (1.0, (0.72, 0.05, 0.06))])
    glint = np.maximum(step(large, 0.38, 0.2) * label, 0.8 * step(small, 0.4, 0.2) * other)
    image = mix(image, (1.0, 0.52, 0.38), 0.7 * glint)
    stripe = step(np.abs(np.abs(points[..., 0]) - 0.2), 0.10, 0.085)
    cream = ramp(0.5 + 0.2 * depth + 0.3 * glint, [(0.0, (0.80, 0.76, 0.66)), (1.0, (0.98, 0.96, 0.9))])
    return unit(mix(image, cream, stripe)), np.full(depth.shape, 0.5), unit(0.42 - 0.15 * glint)


def swirl(points: np.ndarray, seed: int) -> Painted:
    """A glass marble: ribbons of white, teal and amber wound about the axis in deep blue."""
    warp = np.stack([fractal(points, 0.9, 2, seed + k) for k in range(2)], -1)
    turn = np.arctan2(points[..., 1], points[..., 0])
    phase = 3.0 * turn + 4.2 * points[..., 2] + 1.1 * warp[..., 0]
    ribbon, second = np.sin(phase), np.sin(2.0 * phase + 1.3 + 1.4 * warp[..., 1])
    bubble, label = spots(points, 8.0, seed + 3)
    grain = fractal(points, 7.0, 3, seed + 4)
    image = ramp(0.5 + 0.2 * grain, [(0.0, (0.03, 0.08, 0.28)), (1.0, (0.12, 0.32, 0.62))])
    image = mix(
        image, ramp(grain, [(-1.5, (0.72, 0.8, 0.86)), (1.5, (0.98, 0.99, 0.98))]), step(ribbon, 0.45, 0.7)
    )
    image = mix(
        image,
        ramp(grain, [(-1.5, (0.75, 0.33, 0.03)), (1.5, (0.99, 0.7, 0.2))]),
        step(second, 0.72, 0.86) * step(ribbon, 0.3, 0.0),
    )
    image = mix(image, (0.1, 0.62, 0.6), 0.9 * step(np.abs(ribbon + 0.35), 0.16, 0.08))
    image = mix(image, (0.9, 0.97, 1.0), step(bubble, 0.05 + 0.12 * label, 0.03 + 0.08 * label))
    return unit(image), np.full(grain.shape, 0.5), np.full(grain.shape, 0.1)
