"""SuperSplat's compressed PLY: 16 bytes a Gaussian, in chunks of 256 with the least and the largest values of each.

Layout: PlayCanvas's splat-transform. Axes are those of the PLY that it was made of.
"""

from typing import BinaryIO

import numpy as np

from tg4mm.core.splatfile import model
from tg4mm.core.splatfile.header import blocks, columns
from tg4mm.core.splatfile.model import drawable

from ..errors import SplatFileError
from .header import Element, Header
from .model import SplatFile

CHUNK = 256  # Gaussians
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_FIRST = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")
_SCALES = ("min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z")
_COLOURS = ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b")  # newer files have them
_REST = (9, 24, 45)


def read(file: BinaryIO, header: Header, vertex: Element) -> SplatFile:
    """The Gaussians of a compressed PLY whose size fits its header. SplatFileError without the file's name."""
    elements = {element.name: element for element in header.elements}
    chunk, rest = elements.get("chunk"), elements.get("sh")
    _check(vertex, chunk, rest)
    assert chunk is not None
    packed = np.concatenate(
        [np.ascontiguousarray(columns(block, PACKED), np.uint32) for block in blocks(file, header, vertex)]
    )
    bounds = np.concatenate(list(blocks(file, header, chunk)))
    of = np.arange(len(packed)) // CHUNK  # whose chunk

    def between(names: tuple[str, ...], part: np.ndarray) -> np.ndarray:
        ends = columns(bounds, names).astype(np.float64)[of]
        return ends[:, :3] * (1 - part) + ends[:, 3:] * part

    position, rotation, scale, colour = packed.T
    rgba = np.stack([colour >> np.uint32(s) & np.uint32(255) for s in (24, 16, 8, 0)], axis=1) / 255
    rgb = between(_COLOURS, rgba[:, :3]) if _COLOURS[0] in chunk.properties else rgba[:, :3]
    sh = model.f_dc(rgb)[:, None]
    if rest is not None:
        sh = np.concatenate([sh, _harmonics(file, header, rest)], axis=1)
    with np.errstate(over="ignore"):
        fields = {
            "means": between(_FIRST, _thirds(position)),
            "quats": _quats(rotation),
            "scales": np.exp(between(_SCALES, _thirds(scale))),
            "opacities": rgba[:, 3],
            "sh": sh,
        }
    return drawable(fields)


def _check(vertex: Element, chunk: Element | None, rest: Element | None) -> None:
    """Raises SplatFileError, naming what is missing or does not fit."""
    if chunk is None:
        raise SplatFileError("is compressed, but has no element chunk with the least and largest values")
    for element, wanted, kind in ((vertex, PACKED, "<u4"), (chunk, (*_FIRST, *_SCALES), "<f4")):
        wrong = [name for name in wanted if element.properties.get(name) != kind]
        if wrong:
            raise SplatFileError(
                f"is compressed, and element {element.name} has no property {wrong[0]} of the type {kind}"
            )
    if any(name in chunk.properties for name in _COLOURS) and not all(
        chunk.properties.get(name) == "<f4" for name in _COLOURS
    ):
        raise SplatFileError(
            f"is compressed, and element chunk has not all of {', '.join(_COLOURS)} as float"
        )
    if chunk.count != -(-vertex.count // CHUNK):
        raise SplatFileError(
            f"has {chunk.count} chunks for {vertex.count} Gaussians; expected one for {CHUNK}"
        )
    if rest is not None:
        n = len(rest.properties)
        fits = n in _REST and all(rest.properties.get(name) == "<u1" for name in model.f_rest(n))
        if not fits or rest.count != vertex.count:
            raise SplatFileError(
                f"element sh has {n} properties and {rest.count} entries; expected {_REST} of type uchar, "
                f"f_rest_0 on, and {vertex.count} entries"
            )


def _thirds(packed: np.ndarray) -> np.ndarray:
    """[N, 3] in 0 … 1 of 11, 10 and 11 bits."""
    parts = ((21, 2047), (11, 1023), (0, 2047))
    return np.stack([(packed >> np.uint32(s) & np.uint32(most)) / most for s, most in parts], axis=1)


def _quats(packed: np.ndarray) -> np.ndarray:
    """[N, 4] wxyz: which is the largest in the 2 highest bits, then 10 bits for each other one, in ±√½."""
    others = np.stack([packed >> np.uint32(s) & np.uint32(1023) for s in (20, 10, 0)], axis=1) / 1023
    return largest_put_in(np.sqrt(2) * (others - 0.5), (packed >> np.uint32(30)).astype(np.intp))


def largest_put_in(others: np.ndarray, which: np.ndarray) -> np.ndarray:
    """[N, 4] unit quaternions of three components [N, 3] in order, and the place [N] of the fourth, a positive one."""
    quats = np.empty((len(others), 4))
    square = 1 - (others**2).sum(axis=1)
    for place in range(4):
        rows = which == place
        quats[rows] = np.insert(others[rows], place, np.sqrt(np.maximum(square[rows], 0)), axis=1)
    return quats


def _harmonics(file: BinaryIO, header: Header, rest: Element) -> np.ndarray:
    """[N, K − 1, 3]: bytes of ±4, in the middle of each step."""
    k = len(rest.properties) // 3
    raw = np.concatenate([columns(block, model.f_rest(3 * k)) for block in blocks(file, header, rest)])
    values = ((raw.astype(np.float32) + 0.5) / 256 - 0.5) * 8
    values[raw == 0], values[raw == 255] = -4, 4
    return values.reshape(-1, 3, k).transpose(0, 2, 1)
