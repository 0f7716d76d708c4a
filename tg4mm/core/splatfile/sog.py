"""SOG, PlayCanvas's format: Gaussians as pixels of lossless WebP pictures, described by meta.json; .sog is a zip of it.

Versions 1 and 2. Axes are those of the PLY that it was made of.
"""

import io
import json
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.splatfile import model
from tg4mm.core.splatfile.gltf import beside
from tg4mm.core.splatfile.model import Decode, Head, Options, drawable

from ..errors import SplatFileError
from ..untrusted import DEFLATE, parse_json
from ..values import Number
from .model import SplatFile
from .supersplat import largest_put_in

META = "meta.json"
_LARGEST = 1 << 30  # bytes of a picture as it is packed
_PIXELS_SPARE = 1 << 20  # pixels, at most, of a picture beyond four for each Gaussian
_LABELS = 64  # centroids in a row
_TAG = 252  # of a rotation whose largest component is w


class _Files:
    """meta.json and its pictures, in a zip or in a folder."""

    def __init__(self, path: Path) -> None:
        self._path, self._zip, self._inside = path, None, ""
        if path.suffix.lower() == ".json":
            return
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(path.read_bytes()))
        except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            raise SplatFileError(f"is damaged: {' '.join(str(error).split())}") from None
        found = [name for name in self._zip.namelist() if name.rsplit("/", 1)[-1] == META]
        if len(found) != 1:
            raise SplatFileError(f"is a zip with {len(found)} {META}; a SOG has one")
        self._inside = found[0].removesuffix(META)

    def meta(self) -> dict[str, Any]:
        data = self.read(META) if self._zip is not None else self._path.read_bytes()
        try:
            value = parse_json(data, finite=True)
        except (ValueError, UnicodeDecodeError) as error:
            raise SplatFileError(f"{META} is not valid: {error}") from None
        if not isinstance(value, dict) or "means" not in value:
            raise SplatFileError("is JSON, but neither glTF nor the meta.json of a SOG")
        return value

    def read(self, name: str) -> bytes:
        """The bytes of a file that meta.json names."""
        if self._zip is None:
            path = beside(self._path.parent, name)
            if path.stat().st_size > _LARGEST:
                raise SplatFileError(f"{name[:60]} has more than {_LARGEST} bytes")
            return path.read_bytes()
        try:
            entry = self._zip.getinfo(self._inside + name)
            if entry.file_size > min(_LARGEST, DEFLATE * (entry.compress_size + 1)):
                raise SplatFileError(f"{name[:60]} promises {entry.file_size} bytes, more than it can hold")
            return self._zip.read(entry)
        except KeyError:
            raise SplatFileError(f"has no file {name[:60]!r}, which its {META} names") from None
        except (
            zipfile.BadZipFile,
            zlib.error,
            EOFError,
            RuntimeError,
            NotImplementedError,
            ValueError,
            OSError,
        ) as error:
            if isinstance(error, SplatFileError):
                raise
            raise SplatFileError(f"{name[:60]} is damaged: {' '.join(str(error).split())[:80]}") from None


def head_of_sog(path: Path) -> Head:
    """Return the header from meta.json."""
    meta = _Files(path).meta()
    return Head(f"SOG {_version(meta)}", _count(meta))


def read_sog(path: Path, options: Options) -> SplatFile:
    """The Gaussians of a SOG. SplatFileError without the file's name."""
    files = _Files(path)
    meta = files.meta()
    n, decode = _count(meta), options.decode or _pillow()

    def pixels(part: str, number: int = 0, least: int = n) -> np.ndarray:
        """[H, W, 4] of a picture."""
        names = _part(meta, part).get("files")
        if not isinstance(names, list) or len(names) <= number or not isinstance(names[number], str):
            raise SplatFileError(f"{META}: {part}.files is {str(names)[:60]}; expected names of pictures")
        return _decoded(files.read(names[number]), names[number], decode, least)

    def flat(part: str, number: int = 0) -> np.ndarray:
        return pixels(part, number).reshape(-1, 4)[:n]

    means, quats, sh0 = _part(meta, "means"), flat("quats"), flat("sh0")
    fine = flat("means", 1)[:, :3].astype(np.float64) * 256 + flat("means")[:, :3]
    low, high = _numbers(means, "mins", 3), _numbers(means, "maxs", 3)
    places = low + np.where(high > low, high - low, 1.0) * fine / 65535
    scales, colours = _table(meta, "scales", 3), _table(meta, "sh0", 4)
    opacities = sh0[:, 3] / 255 if _version(meta) == 2 else model.sigmoid(colours[sh0[:, 3], 3])
    sh = _looked_up(colours, sh0[:, :3])[:, None]
    if "shN" in meta:
        sh = np.concatenate([sh, _harmonics(meta, pixels, flat)], axis=1)
    tag = quats[:, 3].astype(np.intp) - _TAG
    turns = largest_put_in((quats[:, :3] / 255 * 2 - 1) / math.sqrt(2), np.maximum(tag, 0))
    turns[tag < 0] = 0  # said by `drawable`, with their number
    with np.errstate(over="ignore"):
        fields = {
            "means": np.sign(places) * np.expm1(np.abs(places)),
            "quats": turns,
            "scales": np.exp(_looked_up(scales, flat("scales")[:, :3])),
            "opacities": opacities,
            "sh": sh,
        }
    return drawable(fields)


def _version(meta: dict[str, Any]) -> int:
    version = meta.get("version", 1)  # files of version 1 do not say it
    if version not in (1, 2) or isinstance(version, bool):
        raise SplatFileError(f"is SOG of version {str(version)[:40]}; this reader knows 1 and 2")
    return int(version)


def _count(meta: dict[str, Any]) -> int:
    count: Any
    if _version(meta) == 2:
        count = meta.get("count")
    else:
        shape = _part(meta, "means").get("shape")
        count = shape[0] if isinstance(shape, list) and shape else None
    if not Number(1, 2**32 - 1, whole=True).fits(count):
        raise SplatFileError(f"{META}: the count is {str(count)[:40]}; expected a whole number above 0")
    return int(count)


def _part(meta: dict[str, Any], name: str) -> dict[str, Any]:
    part = meta.get(name)
    if not isinstance(part, dict):
        raise SplatFileError(f"{META}: {name} is {str(part)[:40]}; expected an object")
    return part


def _numbers(part: dict[str, Any], name: str, width: int) -> np.ndarray:
    """[width] of a list of numbers, or of one number for all."""
    value = part.get(name)
    values = value if isinstance(value, list) else [value] * width
    if len(values) != width or not all(map(Number().fits, values)):
        raise SplatFileError(f"{META}: {name} is {json.dumps(value)[:60]}; expected {width} finite numbers")
    return np.array(values, np.float64)


def _table(meta: dict[str, Any], name: str, width: int) -> np.ndarray:
    """[256, width]: what a byte of each channel stands for."""
    part = _part(meta, name)
    if _version(meta) == 2:
        return np.repeat(_numbers(part, "codebook", 256)[:, None], width, axis=1)
    low, high = _numbers(part, "mins", width), _numbers(part, "maxs", width)
    return low + (high - low) * np.arange(256)[:, None] / 255


def _looked_up(table: np.ndarray, bytes_: np.ndarray) -> np.ndarray:
    """[N, C] float32: the byte of each channel in its column of the table."""
    return np.stack([table[bytes_[:, c], c] for c in range(bytes_.shape[1])], axis=1).astype(np.float32)


def _harmonics(meta: dict[str, Any], pixels: Any, flat: Any) -> np.ndarray:
    """[N, K − 1, 3]: each Gaussian names one of up to 65,536 sets of coefficients."""
    table, centroids = _table(meta, "shN", 3), pixels("shN", 0, 1)
    k = centroids.shape[1] // _LABELS
    if k not in (3, 8, 15) or centroids.shape[1] % _LABELS:
        raise SplatFileError(f"its centroids are {centroids.shape[1]} pixels wide; expected 192, 512 or 960")
    labels = flat("shN", 1).astype(np.intp)
    which = labels[:, 0] + 256 * labels[:, 1]
    sets = centroids.reshape(-1, k, 4)[:, :, :3]
    if which.max() >= len(sets):
        raise SplatFileError(
            f"a Gaussian refers to coefficient set {which.max()}, but there are only {len(sets)}, numbered from 0"
        )
    return _looked_up(table, sets.reshape(-1, 3)).reshape(-1, k, 3)[which]


def _decoded(data: bytes, name: str, decode: Decode, least: int) -> np.ndarray:
    """[H, W, 4] of a picture with at least that many pixels."""
    width, height = _size_of_webp(data, name[:60])
    if not least <= width * height <= 4 * least + _PIXELS_SPARE:
        raise SplatFileError(f"{name[:60]} is {width}×{height} pixels, for {least} Gaussians")
    try:
        found = decode(data)
    except (ValueError, OSError, SyntaxError, EOFError, RuntimeError) as error:
        raise SplatFileError(f"{name[:60]} is damaged: {' '.join(str(error).split())[:80]}") from None
    if found.shape != (height, width, 4):
        raise SplatFileError(f"{name[:60]} unpacks to {found.shape}; expected {(height, width, 4)}")
    return found


def _size_of_webp(data: bytes, name: str) -> tuple[int, int]:
    """Width and height of a lossless WebP, from its header."""
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP" or len(data) < 25:
        raise SplatFileError(f"{name} is no WebP picture")
    if (expected := 8 + int.from_bytes(data[4:8], "little")) != len(data):
        raise SplatFileError(f"{name} is truncated or too long: {len(data)} bytes, expected {expected}")
    if data[12:16] == b"VP8X" and len(data) >= 30:
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if data[12:16] != b"VP8L":
        raise SplatFileError(
            f"{name} is a WebP with loss; the numbers in it are not the ones that were written"
        )
    bits = int.from_bytes(data[21:25], "little")
    return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)


def _pillow() -> Decode:
    """The decoder of the program. Raises SplatFileError where Pillow is not there."""
    try:
        from PIL import Image
    except ImportError:
        raise SplatFileError(
            "is SOG, for whose pictures the Python module Pillow is needed: pip install pillow"
        ) from None

    def decode(data: bytes) -> np.ndarray:
        with Image.open(io.BytesIO(data), formats=["WEBP"]) as image:
            return np.asarray(image.convert("RGBA"))

    return decode
