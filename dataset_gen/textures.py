"""Procedural patterns painted in numpy: speckle, brushed metal, scales, bands, knurls, braid, lettering.

Images are [H, W, 3] sRGB (or [H, W] masks and heights) in 0..1. Column = u (around), row = v (along), row 0
is v = 0. They are arrays, not shader nodes, so that one picture serves the renderer of every Blender version
alike.
"""

from collections.abc import Callable

import numpy as np

# A 5×7 font for engraved lettering: one string per row, '#' is ink.
_GLYPHS = {
    "A": " ### |#   #|#   #|#####|#   #|#   #|#   #",
    "C": " ####|#    |#    |#    |#    |#    | ####",
    "D": "#### |#   #|#   #|#   #|#   #|#   #|#### ",
    "E": "#####|#    |#    |#### |#    |#    |#####",
    "G": " ####|#    |#    |#  ##|#   #|#   #| ####",
    "H": "#   #|#   #|#   #|#####|#   #|#   #|#   #",
    "I": "#####|  #  |  #  |  #  |  #  |  #  |#####",
    "M": "#   #|## ##|# # #|# # #|#   #|#   #|#   #",
    "N": "#   #|##  #|# # #|# # #|#  ##|#   #|#   #",
    "O": " ### |#   #|#   #|#   #|#   #|#   #| ### ",
    "R": "#### |#   #|#   #|#### |# #  |#  # |#   #",
    "S": " ####|#    |#    | ### |    #|    #|#### ",
    "T": "#####|  #  |  #  |  #  |  #  |  #  |  #  ",
    "U": "#   #|#   #|#   #|#   #|#   #|#   #| ### ",
    "0": " ### |#  ##|# # #|# # #|##  #|#   #| ### ",
    "1": "  #  | ##  |  #  |  #  |  #  |  #  | ### ",
    "2": " ### |#   #|    #|  ## | #   |#    |#####",
    "4": "   # |  ## | # # |#  # |#####|   # |   # ",
    "5": "#####|#    |#### |    #|    #|#   #| ### ",
    "-": "     |     |     |#####|     |     |     ",
    " ": "     |     |     |     |     |     |     ",
}


def seeded(*scene: int) -> Callable[[int], np.random.Generator]:
    """A scene's generators, by number: patterns belong to the scene; the dataset's seed is the renderer's."""
    return lambda number: np.random.default_rng([*scene, number])


def flat(height: int, width: int, colour: tuple[float, float, float]) -> np.ndarray:
    """One colour."""
    return np.broadcast_to(np.array(colour, float), (height, width, 3)).copy()


def noise(height: int, width: int, cells: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Smooth noise [H, W] of mean 0 and deviation 1, periodic both ways; `cells` = waves along v and u."""
    spectrum = np.fft.rfft2(rng.standard_normal((height, width)))
    fv = np.fft.fftfreq(height)[:, None] * height / cells[0]
    fu = np.fft.rfftfreq(width)[None] * width / cells[1]
    field = np.fft.irfft2(spectrum * np.exp(-0.5 * (fv**2 + fu**2)), s=(height, width))
    return (field - field.mean()) / field.std()


def speckle(
    image: np.ndarray, rng: np.random.Generator, contrast: float, cells: tuple[int, int]
) -> np.ndarray:
    """Hammered, grainy paint: two scales of noise on the lightness."""
    height, width = image.shape[:2]
    coarse = noise(height, width, cells, rng)
    fine = noise(height, width, (cells[0] * 3, cells[1] * 3), rng)
    gain = 1.0 + contrast * np.tanh(0.8 * coarse + 0.5 * fine)
    return np.clip(image * gain[..., None], 0.0, 1.0)


def paint(image: np.ndarray, mask: np.ndarray, colour: tuple[float, float, float]) -> np.ndarray:
    """`colour` where `mask` [H, W] is 1, blended between."""
    weight = mask[..., None]
    return image * (1.0 - weight) + np.array(colour) * weight


def band(height: int, width: int, v0: float, v1: float) -> np.ndarray:
    """Mask of a ring between v0 and v1."""
    v = (np.arange(height) + 0.5) / height
    return np.broadcast_to(((v >= v0) & (v < v1)).astype(float)[:, None], (height, width)).copy()


def ticks(
    height: int, width: int, count: int, v0: float, lengths: tuple[float, float, float], duty: float = 0.25
) -> np.ndarray:
    """Mask of a scale around the part: marks from v0 on, `lengths` of every one, every 5th and every 10th."""
    u = (np.arange(width) + 0.5) / width * count
    v = (np.arange(height) + 0.5) / height
    number = np.floor(u).astype(int)
    reach = np.where(number % 10 == 0, lengths[2], np.where(number % 5 == 0, lengths[1], lengths[0]))
    inside = (v[:, None] >= v0) & (v[:, None] < v0 + reach[None])
    return (inside & ((u % 1.0) < duty)[None]).astype(float)


def ruler(height: int, width: int, count: int, duty: float = 0.3) -> np.ndarray:
    """Mask of a ruler along the part: rings that go all around every 5th time, half around otherwise."""
    v = (np.arange(height) + 0.5) / height * count
    u = (np.arange(width) + 0.5) / width
    around = np.where(np.floor(v).astype(int) % 5 == 0, 1.0, 0.5)
    return ((v % 1.0 < duty)[:, None] & ((u * 2.0) % 1.0 < around[:, None])).astype(float)


def checker(height: int, width: int, cells: tuple[int, int]) -> np.ndarray:
    """Mask of a chessboard, cells along v and u."""
    v = np.floor((np.arange(height) + 0.5) / height * cells[0]).astype(int)
    u = np.floor((np.arange(width) + 0.5) / width * cells[1]).astype(int)
    return ((v[:, None] + u[None]) % 2).astype(float)


def diagonal(height: int, width: int, turns_v: float, turns_u: int) -> np.ndarray:
    """A wave in 0..1 across the diagonal, `turns_u` whole waves around: stripes, threads, half a knurl."""
    v = (np.arange(height) + 0.5) / height
    u = (np.arange(width) + 0.5) / width
    return 0.5 + 0.5 * np.sin(2.0 * np.pi * (turns_v * v[:, None] + turns_u * u[None]))


def knurl(height: int, width: int, turns_v: float, turns_u: int) -> np.ndarray:
    """Height 0..1 of a diamond knurl."""
    return np.minimum(diagonal(height, width, turns_v, turns_u), diagonal(height, width, -turns_v, turns_u))


def lettering(text: str, scale: int) -> np.ndarray:
    """Mask [7·scale, 6·scale·len(text)] of a text, row 0 at the foot of the letters."""
    rows = [np.array([[c == "#" for c in line] for line in _GLYPHS[ch].split("|")]) for ch in text]
    ink = np.concatenate([np.pad(glyph, ((0, 0), (0, 1))) for glyph in rows], axis=1)
    return np.kron(ink[::-1], np.ones((scale, scale)))


def stamp(mask: np.ndarray, decal: np.ndarray, v: float, u: float) -> np.ndarray:
    """`mask` with `decal` added, centred at (u, v)."""
    out = mask.copy()
    top = int(v * mask.shape[0] - decal.shape[0] / 2)
    left = int(u * mask.shape[1] - decal.shape[1] / 2)
    view = out[top : top + decal.shape[0], left : left + decal.shape[1]]
    np.maximum(view, decal, out=view)
    return out
