"""EXR pictures: read, written, and checked for completeness.

A picture's colours are linear light with premultiplied alpha. `decode` gives RGBA with straight alpha, display-referred
sRGB, 16 bits.
"""

import struct
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np

from tg4mm.core.colour import to_display
from tg4mm.core.errors import CaptureError
from tg4mm.core.extras import install
from tg4mm.core.pictures.png import MAX_PIXELS

SIGNATURE = b"\x76\x2f\x31\x01"
_TILED_DEEP_OR_PARTS = 0x200 | 0x800 | 0x1000  # flags of the version field
_ROWS = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}  # compression: rows per chunk
_LARGEST = 65504.0  # a half's
_HEADER_BYTES = 1 << 16


def size(path: Path) -> tuple[int, int]:
    """Width and height in pixels, from the header; CaptureError if the file is no EXR that `decode` takes."""
    width, height, names = _header(path)
    _channels(path, names)
    return width, height


def _header(path: Path) -> tuple[int, int, list[str]]:
    with _opened(path, header_only=True) as file, _damage_as_capture_error(path):
        header = file.header()
        first, last = (np.asarray(corner, np.int64) for corner in header["dataWindow"])
        if not np.array_equal(header["dataWindow"], header["displayWindow"]) or first.any():
            raise CaptureError(
                f"{path}: its pixels span {first.tolist()} to {last.tolist()}, not its whole picture; "
                "write it uncropped"
            )
        names = [channel.name for channel in header["channels"]]
    width, height = (last + 1).tolist()
    if not 0 < width * height <= MAX_PIXELS:
        raise CaptureError(f"{path}: has {width}×{height} pixels, more than {MAX_PIXELS}")
    return width, height, names


def decode(path: Path) -> np.ndarray:
    """Return [H, W, 4] uint16: colour divided by alpha, clipped to 0 … 1, sRGB encoded; opaque if there is no A.

    Colours are taken as linear Rec.709. Raises CaptureError as `linear` does.
    """
    rgba = linear(path)
    alpha = np.clip(rgba[..., 3:], 0, 1)
    colour = np.clip(np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0), 0, 1)
    return np.floor(np.concatenate([to_display(colour), alpha], axis=-1) * 65535 + 0.5).astype(np.uint16)


def linear(path: Path) -> np.ndarray:
    """Read pixels [H, W, 4] float32 as they are stored, colours premultiplied by alpha.

    A grey channel Y stands for all three colours; alpha is 1 where the file has no A.

    Raises CaptureError if the package OpenEXR is absent, the file damaged, a number in it NaN or infinite, or its
    channels are not R, G, B or Y with or without A.
    """
    width, height = size(path)
    pixels = stored(path)
    rgb, alpha = _channels(path, list(pixels))
    found = _stacked(path, pixels, (*rgb, *([alpha] if alpha else [])), (height, width))
    return found if alpha else np.concatenate([found, np.ones_like(found[..., :1])], axis=-1)


def channels(path: Path, names: Sequence[str], wanted: tuple[int, int] | None = None) -> np.ndarray:
    """Return [H, W, C] float32 of the channels `names` of a picture, of the width and height `wanted` if given.

    Raises CaptureError where they are not there, of another size, or not finite.
    """
    width, height, there = _header(path)
    if missing := [name for name in names if name not in there]:
        raise CaptureError(
            f"{path}: has no channel {missing[0]}; there is {', '.join(sorted(there))[:60] or 'none'}"
        )
    if wanted is not None and (width, height) != wanted:
        raise CaptureError(f"{path}: has {width}×{height} pixels; expected {wanted[0]}×{wanted[1]}")
    return _stacked(path, stored(path), names, (height, width))


def stored(path: Path) -> dict[str, np.ndarray]:
    """Return the channels [H, W] of a picture by name, as they are. Raises CaptureError as `linear` does."""
    with _opened(path, header_only=False) as file, _damage_as_capture_error(path):
        return {name: channel.pixels for name, channel in file.channels().items()}


def _stacked(
    path: Path, pixels: Mapping[str, np.ndarray], names: Sequence[str], shape: tuple[int, int]
) -> np.ndarray:
    if any(pixels.get(name) is None or pixels[name].shape != shape for name in names):
        raise CaptureError(f"{path}: cannot be decoded: its channels differ in size")
    numbers = np.stack([pixels[name].astype(np.float32) for name in names], axis=-1)
    if not np.isfinite(numbers).all():
        raise CaptureError(f"{path}: holds {numbers[~np.isfinite(numbers)][0]}; expected finite numbers")
    return numbers


def _channels(path: Path, names: list[str]) -> tuple[tuple[str, str, str], str | None]:
    """Names of the colour channels and of alpha."""
    alpha = "A" if "A" in names else None
    if {"R", "G", "B"} <= set(names):
        return ("R", "G", "B"), alpha
    if "Y" in names and not {"RY", "BY"} & set(names):
        return ("Y", "Y", "Y"), alpha
    raise CaptureError(f"{path}: has channels {', '.join(sorted(names)) or 'none'}; expected R, G, B or Y")


def _opened(path: Path, header_only: bool) -> Any:
    with _damage_as_capture_error(path):
        return _package(path).File(str(path), separate_channels=True, header_only=header_only)


@contextmanager
def _damage_as_capture_error(path: Path) -> Iterator[None]:
    """Convert the package's exceptions for damaged, foreign or missing files to CaptureError."""
    try:
        yield
    except CaptureError:
        raise
    except (RuntimeError, ValueError, KeyError, MemoryError) as error:
        raise CaptureError(f"{path}: cannot be decoded: the EXR is truncated or damaged") from error


def _package(path: Path) -> ModuleType:
    try:
        import OpenEXR
    except ImportError as error:
        raise CaptureError(f"{path}: EXR images need the package OpenEXR: {install('core')}") from error
    return OpenEXR


def encode(pixels: np.ndarray) -> bytes:
    """An EXR of [H, W, 3] or [H, W, 4] float: linear Rec.709, premultiplied, 16-bit floats, ZIP; row 0 on top.

    Needs the package OpenEXR. Values past a half's range are clipped to it.
    """
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise ValueError(f"pixels have shape {pixels.shape}, expected (H, W, 3) or (H, W, 4)")
    half = np.clip(pixels, -_LARGEST, _LARGEST).astype(np.float16)
    with tempfile.TemporaryDirectory(prefix="tg4mm_") as scratch:
        path = Path(scratch) / "a.exr"  # the package writes to names only
        write(path, {"RGBA"[: pixels.shape[2]]: half})
        return path.read_bytes()


def write(path: Path, channels: Mapping[str, np.ndarray]) -> None:
    """Write channels [H, W] by name as a single-part EXR, ZIP, each in its own type, float16 or float32."""
    package = _package(path)
    header = {"compression": package.ZIP_COMPRESSION, "type": package.scanlineimage}
    with package.File(header, {name: np.ascontiguousarray(a) for name, a in channels.items()}) as file:
        file.write(str(path))


def complete(path: Path, width: int, height: int) -> bool:
    """Return whether this is a single-part scan-line EXR of this size with all chunks inside the file.

    Reads the header and the table of chunks, not the pixels; needs no package.
    """
    try:
        with path.open("rb") as file:
            start = file.read(_HEADER_BYTES)
            length = file.seek(0, 2)
            found = _attributes(start)
            if found is None:
                return False
            attributes, at = found
            window = struct.pack("<4i", 0, 0, width - 1, height - 1)
            rows = _ROWS.get(attributes.get(b"compression", b"\xff")[0])
            if attributes.get(b"dataWindow") != window or rows is None:
                return False
            file.seek(at)
            table = file.read(8 * -(-height // rows))
            if len(table) != 8 * -(-height // rows):
                return False
            return all(_inside(file, offset, length) for (offset,) in struct.iter_unpack("<Q", table))
    except (OSError, struct.error, IndexError):
        return False


def _attributes(start: bytes) -> tuple[dict[bytes, bytes], int] | None:
    """Attributes of the header by name, and where it ends; None if it is not a plain EXR's."""
    if not start.startswith(SIGNATURE) or struct.unpack_from("<I", start, 4)[0] & _TILED_DEEP_OR_PARTS:
        return None
    attributes, at = {}, 8
    while start[at] != 0:
        name, _, rest = start[at : at + 600].partition(b"\0")
        kind = rest.partition(b"\0")[0]
        at += len(name) + len(kind) + 2
        (size,) = struct.unpack_from("<I", start, at)
        attributes[name] = start[at + 4 : at + 4 + size]
        at += 4 + size
    return attributes, at + 1


def _inside(file: BinaryIO, offset: int, length: int) -> bool:
    """Return whether the chunk at `offset` lies completely inside the file."""
    if not 0 < offset <= length - 8:
        return False
    file.seek(offset + 4)
    (size,) = struct.unpack("<I", file.read(4))
    return bool(offset + 8 + size <= length)
