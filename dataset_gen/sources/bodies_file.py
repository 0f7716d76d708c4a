"""Checks of a .blend file before Blender opens it, and its contents as one .npz for the planning process."""

import gzip
import json
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tg4mm.core.untrusted import parse_json, read_npz

from .. import tree
from ..cameras import SceneCamera
from ..errors import GenerateError
from ..vibration.fields import Body

_VERSION = 2
_PLAIN = ("unit_scale_m", "own_unit", "camera_names", "warnings", "centre", "radius")
_TAIL = 64  # bytes; the closing block's header is one of 20, 24 or 32 bytes
# "BLENDER-v405" up to 4.5, with "_" for 32-bit pointers and "V" for big-endian; "BLENDER17-01v0502" since.
_HEAD = re.compile(rb"BLENDER(?:[-_][vV](\d{3})|\d\d-\d\d[vV](\d{4}))")
_GZIP, _ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class FileContents:
    """The contents of a user's file, without Blender's handles."""

    bodies: tuple[Body, ...]
    unit_scale_m: float | None  # metres per scene unit, None where the file does not say
    own_unit: tuple[str, float]  # of the file: its name, and how many of it a scene unit is
    cameras: tuple[SceneCamera, ...]  # of the file, the active one first
    camera_names: tuple[str, ...]  # one for each of `cameras`
    warnings: tuple[str, ...]  # one line each: what was left out or replaced
    centre: tuple[float, float, float]  # of the sphere around what is to be looked at, scene units
    radius: float  # of that sphere, scene units


def save(path: Path, found: FileContents) -> None:
    """Writes the file, complete or not at all."""
    arrays: dict[str, np.ndarray] = {}
    for i, body in enumerate(found.bodies):
        arrays |= {f"{i}.vertices": body.vertices, f"{i}.follow": body.follow}
        arrays[f"{i}.triangles"] = body.triangles
        arrays |= {f"{i}.group.{j}": weights for j, weights in enumerate(body.groups.values())}
    bodies = [{"name": body.name, "groups": list(body.groups)} for body in found.bodies]
    cameras = [camera.to_json() for camera in found.cameras]
    plain = {name: getattr(found, name) for name in _PLAIN}
    head = {"version": _VERSION, "bodies": bodies, "cameras": cameras, **plain}
    with tree.whole(path) as temporary:
        np.savez(temporary, head=np.frombuffer(json.dumps(head).encode(), np.uint8), **arrays)


def load(path: Path) -> FileContents:
    """Reads what `save` wrote. Raises GenerateError, one line, for any other file."""
    try:
        data = read_npz(path)
        head = parse_json(data["head"].tobytes())
        if head["version"] != _VERSION:
            raise GenerateError(f"{path}: version {head['version']!r} is not {_VERSION}")
        bodies = tuple(_body(data, i, entry) for i, entry in enumerate(head["bodies"]))
        x, y, z = head["centre"]
        unit, factor = head["own_unit"]
        return FileContents(
            bodies, head["unit_scale_m"], (str(unit), float(factor)),
            tuple(SceneCamera.from_json(camera) for camera in head["cameras"]), tuple(head["camera_names"]),
            tuple(head["warnings"]), (x, y, z), head["radius"],
        )  # fmt: skip
    except GenerateError:
        raise
    except OSError as error:
        raise GenerateError(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise GenerateError(f"{path} does not hold the geometry of a scene: {error}") from error


def _body(data: Any, i: int, entry: dict[str, Any]) -> Body:
    groups = {name: data[f"{i}.group.{j}"] for j, name in enumerate(entry["groups"])}
    return Body(entry["name"], data[f"{i}.vertices"], data[f"{i}.triangles"], data[f"{i}.follow"], groups)


def check(path: Path, running: tuple[int, int]) -> None:
    """Raises GenerateError, one line with the path, unless `path` is a whole .blend that `running` can read.

    `running` is Blender's version, (major, minor). A file compressed with Zstandard, which Python's library
    does not read, is only known to be one: what is in it shows when Blender opens it.
    """
    try:
        with path.open("rb") as file:
            start = file.read(4)
            if start == _ZSTD:
                return
            file.seek(0)
            if start.startswith(_GZIP):
                with gzip.open(file) as plain:
                    _check_plain(path, plain, running)
            else:
                _check_plain(path, file, running)
    except FileNotFoundError:
        raise GenerateError(f"{path} does not exist") from None
    except IsADirectoryError:
        raise GenerateError(f"{path} is a folder, not a .blend file") from None
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise GenerateError(f"{path} is truncated or damaged: its compressed data ends too early") from None
    except OSError as error:
        raise GenerateError(f"{path} cannot be read: {error.strerror or error}") from error


def _check_plain(path: Path, file: BinaryIO | gzip.GzipFile, running: tuple[int, int]) -> None:
    found = _HEAD.match(tail := file.read(32))
    if found is None:
        what = "is empty" if not tail else f"is not a .blend file: it begins with {tail[:8]!r}"
        raise GenerateError(f"{path} {what}")
    check_version(path, divmod(int(found[1] or found[2]), 100), running)
    while block := file.read(1 << 20):
        tail = (tail + block)[-_TAIL:]
    if b"ENDB" not in tail:
        raise GenerateError(f"{path} is truncated: the block that closes a .blend file is missing")


def check_version(path: Path, saved: tuple[int, int], running: tuple[int, int]) -> None:
    """Raises GenerateError if a newer Blender than the running one saved the file."""
    if saved > running:
        raise GenerateError(
            f"{path} was saved by Blender {saved[0]}.{saved[1]}, newer than this Blender "
            f"{running[0]}.{running[1]}: use that version, or save the file in this one"
        )
