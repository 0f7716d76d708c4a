"""Surfaces of the chair: green and gold brocade, carved honey-coloured wood, brass, cord, fringe."""

import numpy as np

from .. import textures as t
from ..patterns import solid as unroll
from ..patterns.furnishing import HONEY, damask, velvet, wood
from ..patterns.furnishing import cord as twisted
from ..patterns.solid import fractal, mix, noise, ramp, step, unit
from ..scene import Surface

_GREEN = ((0.045, 0.20, 0.12), (0.20, 0.47, 0.30))
_GOLD = ((0.52, 0.36, 0.10), (0.96, 0.82, 0.46))

_rng = t.seeded(2027)


def brocade(name: str, texels: np.ndarray, up: int, seed: int, pulled: np.ndarray | None = None) -> Surface:
    """Green velvet with a gold damask at texels [H, W, 3]; the cloth's length runs along x (`up` 0) or z (`up` 1).

    The lower half of the picture (v ≥ ½) is the other side of a puffed body: plain with stripes. `pulled` [R, S] is how
    deep the tufts are: their folds lie in shade and collect dust.
    """
    along = texels[..., 0] if up == 0 else texels[..., 2]
    pattern = damask(texels[..., 1], along, (0.235, 0.30))
    height, width = pattern.shape
    v = ((np.arange(height) + 0.5) / height)[:, None]
    behind = step(v + 0.0 * pattern, 0.502, 0.508)
    stripe = step(np.abs((texels[..., 1] / 0.07) % 1.0 - 0.5), 0.13, 0.09)
    pattern = pattern * (1.0 - behind) + 0.8 * stripe * behind
    image, relief, rough = velvet(texels, pattern, _GREEN, _GOLD, seed)
    if pulled is not None:
        grid = np.concatenate([pulled, np.zeros_like(pulled[1:])])[..., None].repeat(3, -1)
        fold = unroll.of_grid(grid, height, width)[..., 0] / pulled.max()
        image = image * (1.0 - 0.45 * fold[..., None])
    return Surface(name, unit(image), relief, 0.005, roughness=rough, sheen=0.35)


def _carved(height: int, width: int, count: int) -> np.ndarray:
    """Relief [H, W] of overlapping leaves along a moulding, two rows around it."""
    v = ((np.arange(height) + 0.5) / height * count)[:, None]
    u = (np.arange(width) + 0.5) / width
    across = np.abs((u * 2.0 + 0.25) % 1.0 - 0.5)[None] * 2.0  # 0 on the middle line of a row
    place = (v - 0.35 * (1.0 - across**2)) % 1.0
    body = np.sqrt(np.maximum(1.0 - (across / np.maximum(0.75 * (1.0 - 0.7 * place), 0.05)) ** 2, 0.0))
    vein = 1.0 - 0.5 * step(across + 0.0 * place, 0.12, 0.04)
    return unit(body * vein * (0.4 + 0.6 * place))


def _timber(name: str, length: float, seed: int, carving: int, height: int = 768, width: int = 96) -> Surface:
    points = unroll.of_tube(0.05, length, height, width)
    image, pores = wood(points + [0.3 * seed, 0.0, 0.0], 26.0, HONEY, seed)
    relief = 0.5 - 0.3 * pores
    if carving:
        cut = _carved(height, width, carving)
        gold = ramp(
            cut + 0.1 * noise(points, 40.0, seed), [(0.0, (0.30, 0.16, 0.05)), (1.0, (0.9, 0.7, 0.36))]
        )
        image = mix(image, gold, 0.75 * step(cut, 0.05, 0.3))
        relief = unit(0.25 + 0.6 * cut - 0.1 * pores)
    worn = fractal(points, 8.0, 3, seed + 5)
    return Surface(
        name, unit(image * (1.0 + 0.07 * worn[..., None])), relief, 0.007, roughness=0.38, coat=0.3,
        coat_roughness=0.15,
    )  # fmt: skip


def legs() -> Surface:
    return _timber("legs", 0.95, 11, 0)


def stiles() -> Surface:
    return _timber("stiles", 0.65, 12, 9)


def rail(name: str, length: float, seed: int) -> Surface:
    return _timber(name, length, seed, round(length / 0.075), 1536)


def gilt(name: str, seed: int) -> Surface:
    points = unroll.of_grid(
        np.array([[[0, 0, 0], [0.2, 0, 0]], [[0, 0.3, 0], [0.2, 0.3, 0]]], float), 256, 256
    )
    rub = fractal(points, 14.0, 4, 30 + seed)
    image = ramp(
        rub,
        [
            (-2.0, (0.42, 0.2, 0.08)),
            (-0.8, (0.70, 0.47, 0.18)),
            (0.6, (0.88, 0.68, 0.32)),
            (2.0, (0.98, 0.86, 0.55)),
        ],
    )
    return Surface(
        name, unit(image), unit(0.5 + 0.15 * rub), 0.004, metallic=0.45, roughness=unit(0.42 - 0.05 * rub)
    )


def brass(name: str) -> Surface:
    image = t.speckle(t.flat(128, 256, (0.86, 0.67, 0.33)), _rng(4), 0.35, (6, 14))
    return Surface(name, image, metallic=0.7, roughness=0.33)


def button() -> Surface:
    swirl = t.diagonal(96, 192, 1.0, 8)
    image = ramp(swirl, [(0.0, (0.42, 0.28, 0.08)), (1.0, (0.93, 0.77, 0.40))])
    return Surface("button", image, swirl, 0.003, roughness=0.6, sheen=0.2)


def cord(name: str, turns: float) -> Surface:
    image, ridge = twisted(1536, 32, turns, _GOLD, ((0.03, 0.17, 0.1), (0.22, 0.5, 0.32)), 20)
    return Surface(name, image, ridge, 0.005, roughness=0.65, sheen=0.2)


def fringe() -> Surface:
    h, w = 128, 64
    v = ((np.arange(h) + 0.5) / h)[:, None]
    thread = t.diagonal(h, w, 6.0, 3)
    image = ramp(thread + 0.0 * v, [(0.0, (0.50, 0.34, 0.10)), (1.0, (0.95, 0.8, 0.44))])
    tip = step(v + 0.0 * thread, 0.6, 0.7)
    return Surface(
        "fringe", unit(mix(image, (0.10, 0.33, 0.2), 0.8 * tip)), thread, 0.003, roughness=0.7, sheen=0.2
    )
