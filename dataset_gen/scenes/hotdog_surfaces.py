"""Surfaces of the hot dogs: baked crust and crumb, grilled casing, grainy sauces, speckled glaze with a painted rim."""

from collections.abc import Sequence

import numpy as np

from .. import textures as t
from ..patterns import solid as unroll
from ..patterns.solid import fractal, mix, noise, ramp, spots, step, unit
from ..scene import Surface

_rng = t.seeded(2026)


def bun(texels: np.ndarray, axis_height: float, seed: int) -> Surface:
    """Golden crust outside, darker on the cheeks, cream crumb with pores inside. Texels [H, W, 3]; v ≥ ½ is inside."""
    height = len(texels)
    v = ((np.arange(height) + 0.5) / height)[:, None]
    rough = fractal(texels, 7.0, 4, seed)
    fine = fractal(texels, 38.0, 2, seed + 1)
    high = (texels[..., 2] - axis_height) / 0.2
    baked = 0.55 + 0.2 * np.sin(2.4 * high + 1.0) + 0.13 * rough + 0.06 * fine
    crust = ramp(
        baked,
        [
            (0.0, (0.96, 0.84, 0.58)),
            (0.35, (0.93, 0.71, 0.36)),
            (0.65, (0.86, 0.55, 0.22)),
            (0.95, (0.68, 0.36, 0.12)),
        ],
    )
    near, _ = spots(texels + 0.01 * fine[..., None], 30.0, seed)
    blister = step(near, 0.17, 0.07)
    crust = mix(crust, (0.47, 0.23, 0.08), 0.55 * blister)
    crust = mix(crust, (0.97, 0.88, 0.7), 0.5 * step(fine + 0.4 * rough, 1.5, 2.3))  # flour
    pore, label = spots(texels, 21.0, seed + 3)
    hole = step(pore, 0.42, 0.2) * step(label, 0.35, 0.45)
    crumb = ramp(0.5 + 0.25 * rough + 0.2 * fine, [(0.0, (0.86, 0.74, 0.52)), (1.0, (0.98, 0.92, 0.78))])
    crumb = mix(crumb, (0.68, 0.5, 0.28), 0.75 * hole)
    inner = step(v + 0.006 * rough, 0.505, 0.53)
    image = mix(crust, crumb, inner)
    relief = unit(0.55 + 0.1 * rough + 0.12 * fine - (0.3 * blister) * (1 - inner) - 0.5 * hole * inner)
    return Surface(f"bun {seed}", unit(image), relief, 0.012, roughness=unit(0.42 + 0.4 * inner), sheen=0.1)


def sausage(radius: float, length: float, seed: int) -> Surface:
    h, w = 768, 320
    p = unroll.of_tube(radius, length, h, w)
    rough, fine = fractal(p, 6.0, 3, seed + 10), fractal(p, 45.0, 2, seed + 11)
    image = ramp(
        0.5 + 0.24 * rough + 0.12 * fine,
        [(0.0, (0.45, 0.15, 0.07)), (0.5, (0.66, 0.27, 0.13)), (1.0, (0.82, 0.42, 0.22))],
    )
    image = mix(image, (0.9, 0.62, 0.42), 0.6 * step(fine - 0.3 * rough, 1.35, 2.0))
    spot, _ = spots(p, 24.0, seed + 4)
    image = mix(image, (0.24, 0.08, 0.04), 0.75 * step(spot, 0.2, 0.1))
    slanted = p[..., 2] + 0.55 * p[..., 1] * (1 if seed % 2 else -1) + 0.008 * rough
    wave = np.cos(2.0 * np.pi * slanted / 0.155)
    char = step(wave + 0.22 * rough + 0.12 * fine, 0.55, 0.86)
    image = mix(image, ramp(fine, [(-1.0, (0.09, 0.04, 0.03)), (1.5, (0.27, 0.12, 0.07))]), 0.92 * char)
    ends = step(np.abs(p[..., 2] - length / 2.0), length / 2.0 - 0.12, length / 2.0)
    image = mix(image, (0.36, 0.13, 0.07), 0.55 * ends)
    relief = unit(0.6 + 0.08 * rough + 0.05 * fine - 0.35 * char)
    shine = unit(0.3 + 0.05 * fine + 0.3 * char)
    return Surface(
        f"sausage {seed}", unit(image), relief, 0.01, roughness=shine, coat=0.25, coat_roughness=0.2
    )


def _sauce(name: str, number: int, low: tuple, high: tuple, grain: tuple, rough: float) -> Surface:
    p = unroll.of_tube(0.028, 4.0, 1536, 32)
    flow, fine = fractal(p, [30.0, 30.0, 14.0], 3, number), noise(p, 90.0, number + 1)
    image = ramp(0.5 + 0.3 * flow + 0.1 * fine, [(0.0, low), (1.0, high)])
    spot, _ = spots(p, 45.0, number)
    image = mix(image, grain, 0.8 * step(spot, 0.32, 0.15))
    return Surface(
        name, unit(image), unit(0.5 + 0.2 * flow + 0.1 * fine), 0.004, roughness=rough, coat=0.35,
        coat_roughness=0.15,
    )  # fmt: skip


def mustard() -> Surface:
    return _sauce("mustard", 40, (0.82, 0.54, 0.03), (0.99, 0.83, 0.16), (0.5, 0.27, 0.04), 0.35)


def ketchup() -> Surface:
    return _sauce("ketchup", 44, (0.5, 0.03, 0.015), (0.83, 0.12, 0.05), (0.96, 0.4, 0.2), 0.25)


def sesame() -> Surface:
    image = t.speckle(t.flat(64, 128, (0.95, 0.86, 0.64)), _rng(1), 0.2, (4, 12))
    tip = step(np.arange(64.0) / 64.0, 0.55, 1.0)[:, None] * np.ones((1, 128))
    return Surface("sesame", unit(mix(image, (0.66, 0.42, 0.18), 0.8 * tip)), roughness=0.45)


def crumb() -> Surface:
    p = unroll.of_ball(64, 128)
    n = fractal(p, 1.6, 4, 50)
    return Surface(
        "crumb",
        unit(ramp(n, [(-1.5, (0.55, 0.3, 0.1)), (-0.2, (0.85, 0.62, 0.34)), (1.2, (0.98, 0.9, 0.74))])),
        roughness=0.85,
    )


def plate(outline: Sequence[Sequence[float]]) -> Surface:
    h, w = 640, 1536
    p = unroll.of_revolved(outline, h, w)
    radius, angle = np.hypot(p[..., 0], p[..., 1]), np.arctan2(p[..., 1], p[..., 0])
    cloud, fine = fractal(p, 2.6, 3, 60), fractal(p, 26.0, 2, 61)
    image = ramp(0.5 + 0.22 * cloud + 0.1 * fine, [(0.0, (0.80, 0.80, 0.76)), (1.0, (0.95, 0.94, 0.9))])
    spot, label = spots(p, 16.0, 62)
    image = mix(image, (0.42, 0.3, 0.2), 0.75 * step(spot, 0.09 + 0.14 * label, 0.04 + 0.1 * label))
    ink = unit(_rim(radius, angle) * (0.83 + 0.16 * fine))
    image = mix(image, ramp(cloud + 0.6 * fine, [(-1.2, (0.09, 0.16, 0.42)), (1.2, (0.25, 0.4, 0.7))]), ink)
    image = mix(image, (0.62, 0.43, 0.2), 0.85 * step(radius, 1.222, 1.232))
    return Surface(
        "plate", unit(image), unit(0.5 + 0.1 * cloud + 0.06 * fine - 0.2 * ink), 0.003, roughness=0.22,
        coat=0.4,
    )  # fmt: skip


def _rim(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    def line(at: float, width: float) -> np.ndarray:
        return step(np.abs(radius - at), width, 0.6 * width)

    turn = angle / (2.0 * np.pi)
    a = (turn * 36.0) % 1.0 - 0.5  # along one leaf
    s = (radius - 1.095) / 0.062  # across the band
    leaf = step((a / 0.46) ** 2 + ((s - 0.9 * a) / (0.55 * (1.0 - np.abs(a)))) ** 2, 1.0, 0.8)
    vein = step(np.abs(s - 0.9 * a), 0.16, 0.08)
    b = ((turn * 36.0 + 0.5) % 1.0 - 0.5) * 2.0 * np.pi * 1.1 / 36.0
    dots = step(np.hypot(b, np.abs(radius - 1.1) - 0.042), 0.018, 0.012)
    c = ((turn * 72.0) % 1.0 - 0.5) * 2.0
    scallop = step(np.abs(radius - 1.0 - 0.028 * np.sqrt(np.maximum(1.0 - c**2, 0.0))), 0.009, 0.005)
    inner = step(
        np.hypot(((turn * 96.0) % 1.0 - 0.5) * 2.0 * np.pi * 0.93 / 96.0, radius - 0.93), 0.013, 0.008
    )
    ink = np.maximum.reduce([leaf * (1.0 - 0.8 * vein), dots, scallop, inner])
    for at, width in (
        (1.185, 0.012),
        (1.205, 0.005),
        (1.165, 0.005),
        (0.985, 0.008),
        (0.955, 0.004),
        (0.905, 0.004),
    ):
        ink = np.maximum(ink, line(at, width))
    return ink
