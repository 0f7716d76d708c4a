"""Opening a splat file of any kind, recognised by its first bytes or, failing that, by its name.

.splat, of antimatter15's viewer: 32 bytes a Gaussian and nothing else, so that a file cut between two is one.
Position and linear scale as float32, colour and opacity, rotation wxyz as bytes. Axes are those of the PLY that it
was made of.
"""

import contextlib
import logging
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import gltf, model, spz
from tg4mm.core.splatfile.gltf import head_of_gltf, read_gltf
from tg4mm.core.splatfile.model import Decode, Head, Options, SplatFile, drawable
from tg4mm.core.splatfile.ply import head_of_ply, read_ply
from tg4mm.core.splatfile.sog import head_of_sog, read_sog

_RECORD = np.dtype([("place", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])
ENDINGS = (".ply", ".splat", ".spz", ".sog", ".glb", ".gltf", ".json")  # of files that can be read
_OTHERS = {  # known, and not read
    ".ksplat": "KSPLAT, of one viewer alone",
    ".splatv": "SPLATV, a 4D format of one viewer alone",
    ".npz": "a NumPy archive, as Dynamic 3D Gaussians write",
    **dict.fromkeys((".pth", ".pt", ".ckpt"), "a checkpoint of PyTorch, as trainers of 4D Gaussians write"),
    ".lcc": "LCC",
    ".usd": "USD",
    ".usda": "USD",
    ".usdc": "USD",
    ".usdz": "USD",
}
_LOG = logging.getLogger("tg4mm")


def head_of_splat(size: int) -> Head:
    """Derive the header from the file's length."""
    if size == 0 or size % _RECORD.itemsize:
        raise SplatFileError(
            f"is {size} bytes long, not a positive multiple of the {_RECORD.itemsize} bytes per Gaussian of a .splat: "
            "it is cut off, or is not a .splat file"
        )
    return Head(".splat", size // _RECORD.itemsize)


def read_antimatter(file: BinaryIO, size: int) -> SplatFile:
    """The Gaussians of a .splat. SplatFileError without the file's name."""
    count = head_of_splat(size).count
    records = np.fromfile(file, _RECORD, count)
    if len(records) != count:
        raise SplatFileError(f"is truncated: {len(records)} Gaussians, expected {count}")
    rgba = records["rgba"] / np.float32(255)
    fields = {
        "means": records["place"],
        "quats": records["turn"] / np.float32(128) - 1,
        "scales": records["scale"],
        "opacities": rgba[:, 3],
        "sh": model.f_dc(rgba[:, None, :3]),
    }
    return drawable(fields)


def read_splat(
    path: str | Path, freqs_hz: Sequence[float] = (), fps: float = 30.0, decode: Decode | None = None
) -> SplatFile:
    """Read Gaussians, with their motion if the file holds one. Needs numpy alone, but for SOG and SPZ 4.

    A PLY (ASCII, binary of both byte orders, SuperSplat's compressed one), .splat, SPZ 1 to 4, SOG, glTF with
    KHR_gaussian_splatting: docs/conventions.md says what is read of each, and in which axes. SPZ and glTF are turned
    from Y up to Z up, the others are as in the file.

    Args:
        path: the file; of a SOG that is not packed its meta.json.
        freqs_hz: of a PLY with modes that lost the line which says their frequencies: one for each mode. Without, such
            a file opens still.
        fps: Hz, of that motion.
        decode: of SOG's pictures, a lossless WebP → [H, W, 4] uint8, first row at the top; default: Pillow.

    Returns:
        N Gaussians and their modes; no modes and fps 0 (unknown) where the file says nothing of motion. Its `notes`
        say what was left out or changed; they are logged too.

    Raises:
        SplatFileError: the file is truncated, too long or of another kind, a property is missing, a count does not
            fit, no Gaussian can be drawn. One line with file and value.
    """
    path, options = Path(path), Options(tuple(float(f) for f in freqs_hz), float(fps), decode)
    with _named(path):
        kind = _kind(path)
        if kind == "gltf":
            splat = read_gltf(path)
        elif kind == "sog":
            splat = read_sog(path, options)
        elif kind == "spz":
            splat = spz.read_spz(path.read_bytes())
        else:
            with path.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                splat = read_antimatter(file, size) if kind == "splat" else read_ply(file, size, options)
    for note in splat.notes:
        _LOG.warning("%s: %s", path, note)
    return splat


def read_head(path: str | Path) -> Head:
    """Read a file's header. Raises SplatFileError as `read_splat` does."""
    path = Path(path)
    with _named(path):
        kind = _kind(path)
        if kind == "gltf":
            return head_of_gltf(path)
        if kind == "sog":
            return head_of_sog(path)
        with path.open("rb") as file:
            if kind == "spz":
                return spz.head_of_spz(file)
            return head_of_splat(os.fstat(file.fileno()).st_size) if kind == "splat" else head_of_ply(file)


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Puts the file's name in front of what is wrong with it."""
    try:
        yield
    except OSError as error:
        other = f" ({error.filename})" if error.filename and Path(error.filename) != path else ""
        raise SplatFileError(f"{path}: cannot be read: {error.strerror or error}{other}") from error
    except SplatFileError as error:
        raise SplatFileError(f"{path}: {error}") from error.__cause__


def _kind(path: Path) -> str:
    with path.open("rb") as file:
        start = file.read(64)
    suffix = path.suffix.lower()
    if suffix in _OTHERS and not start.startswith(b"ply"):
        raise SplatFileError(f"is {_OTHERS[suffix]}: not read; save it as PLY, SPZ or glTF")
    if start.startswith((spz.GZIP, spz.NGSP)):
        return "spz"
    if start.startswith(gltf.MAGIC):
        return "gltf"
    if start.startswith(b"PK\x03\x04"):
        return "sog"
    if start.lstrip().startswith(b"{"):
        return "gltf" if suffix == ".gltf" else "sog"
    if not start.startswith(b"ply"):
        if suffix == ".splat":
            return "splat"
        if suffix in ENDINGS and suffix != ".ply":
            raise SplatFileError(f"does not begin as {suffix} files do")
    return "ply"
