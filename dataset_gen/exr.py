"""EXR pictures: linear light with premultiplied alpha, as the format has it; and whether a file is whole."""

import struct
import tempfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

_MAGIC = b"\x76\x2f\x31\x01"
_TILED_DEEP_OR_PARTS = 0x200 | 0x800 | 0x1000  # flags of the version field
_ROWS = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}  # compression: rows per chunk
_LARGEST = 65504.0  # a half's
_HEADER_BYTES = 1 << 16


def encode(pixels: np.ndarray) -> bytes:
    """An EXR of [H, W, 3] or [H, W, 4] float: linear Rec.709, premultiplied, 16-bit floats, ZIP; row 0 on top.

    Needs the package OpenEXR. Values past a half's range are clipped to it.
    """
    import OpenEXR

    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise ValueError(f"pixels have shape {pixels.shape}, expected (H, W, 3) or (H, W, 4)")
    half = np.clip(pixels, -_LARGEST, _LARGEST).astype(np.float16)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {"RGBA"[: pixels.shape[2]]: np.ascontiguousarray(half)}
    with tempfile.TemporaryDirectory(prefix="dataset_gen_") as scratch:
        path = Path(scratch) / "a.exr"  # the package writes to names only
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
        return path.read_bytes()


def complete(path: Path, width: int, height: int) -> bool:
    """True for a single-part scan-line EXR of this size, all of whose chunks lie inside the file.

    Reads the header and the table of chunks, not the pixels; needs no package.
    """
    try:
        with path.open("rb") as file:
            start = file.read(_HEADER_BYTES)
            length = file.seek(0, 2)
            found = _header(start)
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


def _header(start: bytes) -> tuple[dict[bytes, bytes], int] | None:
    """Attributes of the header by name, and where it ends; None if it is not a plain EXR's."""
    if not start.startswith(_MAGIC) or struct.unpack_from("<I", start, 4)[0] & _TILED_DEEP_OR_PARTS:
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
