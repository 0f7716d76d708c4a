"""What opening a user's file found, as one .npz: for the process that plans and does not import Blender."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.untrusted import parse_json, read_npz

from .. import tree
from ..cameras import Camera
from ..errors import GenerateError
from ..vibration.fields import Body

_VERSION = 2
_PLAIN = ("unit_scale_m", "own_unit", "camera_names", "warnings", "centre", "radius")


@dataclass(frozen=True)
class Found:
    """What a user's file holds, without Blender's handles."""

    bodies: tuple[Body, ...]
    unit_scale_m: float | None  # metres per scene unit, None where the file does not say
    own_unit: tuple[str, float]  # of the file: its name, and how many of it a scene unit is
    cameras: tuple[Camera, ...]  # of the file, the active one first
    camera_names: tuple[str, ...]  # one for each of `cameras`
    warnings: tuple[str, ...]  # one line each: what was left out or replaced
    centre: tuple[float, float, float]  # of the sphere around what is to be looked at, scene units
    radius: float  # of that sphere, scene units


def save(path: Path, found: Found) -> None:
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


def load(path: Path) -> Found:
    """Reads what `save` wrote. Raises GenerateError, one line, for any other file."""
    try:
        data = read_npz(path)
        head = parse_json(data["head"].tobytes())
        if head["version"] != _VERSION:
            raise GenerateError(f"{path}: version {head['version']!r} is not {_VERSION}")
        bodies = tuple(_body(data, i, entry) for i, entry in enumerate(head["bodies"]))
        x, y, z = head["centre"]
        unit, factor = head["own_unit"]
        return Found(
            bodies, head["unit_scale_m"], (str(unit), float(factor)),
            tuple(Camera.from_json(camera) for camera in head["cameras"]), tuple(head["camera_names"]),
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
