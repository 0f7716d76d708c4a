"""Reading glTF 2.0 with KHR_gaussian_splatting: .glb, or .gltf with what lies beside it. Y up is turned to Z up.

Of a .glb that tg4mm wrote the motion comes back too: modes from morph targets (`show/export/gltf.py`), but not how
Gaussians turn as they move, which the format does not hold.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SplatFileError
from ..values import Number
from .accessors import Document
from .axes import TURN, transformed
from .drawable import Head, drawable
from .model import SplatFile
from .spz import read_spz

EXTENSION = "KHR_gaussian_splatting"
SPZ = tuple(f"{EXTENSION}_compression_spz{version}" for version in ("", "_2"))
_DEEPEST = 64  # nodes in each other
_MOST_NODES = 10_000  # with splats


def head_of_gltf(path: Path) -> Head:
    """Return the header of the document."""
    document = Document(path)
    count = sum(
        document.accessor(p.get("attributes", {}).get("POSITION"))["count"] for _, p in _splats(document)
    )
    about = _ours(document)
    return Head("glTF", count, len(about["frequencies_hz"]) if about else 0, y_up=True)


def read_gltf(path: Path) -> SplatFile:
    """All Gaussians of the document's scene, Z up. SplatFileError without the file's name."""
    document, parts = Document(path), []
    about = _ours(document)
    metres = about["unit_scale_m"] if about else None
    for matrix, primitive in _splats(document):
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = matrix[:3] / (metres or 1.0)
        if not np.isfinite(matrix).all():
            raise SplatFileError("its nodes together scale or move the splats past any number")
        part = _gaussians(document, primitive, about)
        parts.append(transformed(part, TURN.T @ matrix[:, :3], TURN.T @ matrix[:, 3]))
    splat = parts[0] if len(parts) == 1 else _joined(parts)
    return replace(splat, unit_scale_m=metres)


def _splats(document: Document) -> list[tuple[np.ndarray, dict[str, Any]]]:
    """The world matrix [4, 4] and primitive of all splats in the document's scene."""
    nodes, meshes = document.objects("nodes"), document.objects("meshes")
    scenes = document.objects("scenes")
    start = scenes[document.index(scenes, document.json.get("scene", 0), "scene")] if scenes else {}
    roots = start.get("nodes", []) if scenes else range(len(nodes))
    level: list[tuple[Any, np.ndarray]] = [(i, np.eye(4)) for i in roots]
    found, depth = [], 0
    while level:
        below: list[tuple[Any, np.ndarray]] = []
        for number, above in level:
            node = nodes[document.index(nodes, number, "node")]
            with np.errstate(over="ignore", invalid="ignore"):
                matrix = above @ _matrix(node)
            below += [(child, matrix) for child in node.get("children", [])]
            if "mesh" in node:
                mesh = meshes[document.index(meshes, node["mesh"], "mesh")]
                found += [(matrix, p) for p in mesh.get("primitives", []) if _is_splats(p)]
        level, depth = below, depth + 1
        if depth > _DEEPEST or len(level) > _MOST_NODES or len(found) > _MOST_NODES:
            raise SplatFileError(f"its nodes are more than {_DEEPEST} deep or {_MOST_NODES} wide")
    if not found:
        raise SplatFileError(f"is glTF without Gaussian splats: nothing in its scene has {EXTENSION}")
    return found


def _is_splats(primitive: dict[str, Any]) -> bool:
    told = primitive.get("extensions", {}).get(EXTENSION)
    if told is None:
        return False
    kernel = told.get("kernel", "ellipse")
    if kernel != "ellipse":
        raise SplatFileError(f"has splats of the kernel {str(kernel)[:40]!r}; expected ellipse")
    return True


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """[4, 4] of a node, from its matrix or its translation, rotation and scale."""

    def numbers(name: str, default: list[float]) -> np.ndarray:
        value = node.get(name, default)
        if len(value) != len(default) or not all(math.isfinite(v) for v in value):
            raise SplatFileError(
                f"a node's {name} is {str(value)[:60]}; expected {len(default)} finite numbers"
            )
        return np.array(value, np.float64)

    if "matrix" in node:
        return numbers("matrix", [0.0] * 16).reshape(4, 4).T
    x, y, z, w = numbers("rotation", [0.0, 0.0, 0.0, 1.0])
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turn * numbers("scale", [1.0] * 3)
    matrix[:3, 3] = numbers("translation", [0.0] * 3)
    return matrix


def _gaussians(document: Document, primitive: dict[str, Any], about: dict[str, Any] | None) -> SplatFile:
    told = primitive["extensions"][EXTENSION]
    for name in SPZ:
        if name in (packed := told.get("extensions", {})):
            return read_spz(bytes(document.view(packed[name].get("bufferView"))), turn=False)
    attributes, notes = primitive.get("attributes", {}), []
    if (space := told.get("colorSpace", "srgb_rec709_display")) != "srgb_rec709_display":
        notes.append(
            f"its colours are in {str(space)[:40]}, and taken to be sRGB: their brightness is not right"
        )

    def values(name: str, width: int, prefix: str = f"{EXTENSION}:") -> np.ndarray:
        if prefix + name not in attributes:
            raise SplatFileError(f"splats without the attribute {prefix}{name}")
        found = document.values(attributes[prefix + name], width)
        if len(found) != len(means):
            raise SplatFileError(f"{prefix}{name} has {len(found)} values for {len(means)} Gaussians")
        return found

    means = np.empty(0)
    if "POSITION" in attributes:
        means = document.values(attributes["POSITION"], 3)
    if not len(means):
        raise SplatFileError("splats without the attribute POSITION")
    degree = 0
    while f"{EXTENSION}:SH_DEGREE_{degree + 1}_COEF_0" in attributes:
        degree += 1
    names = [f"SH_DEGREE_{d}_COEF_{i}" for d in range(min(degree, 4) + 1) for i in range(2 * d + 1)]
    fields = {
        "means": means,
        "quats": values("ROTATION", 4)[:, [3, 0, 1, 2]],
        "scales": values("SCALE", 3),
        "opacities": values("OPACITY", 1)[:, 0],
        "sh": np.stack([values(name, 3) for name in names], axis=1),
    }
    targets = [document.values(t.get("POSITION"), 3) for t in primitive.get("targets", [])]
    if about is not None:
        return drawable(fields | _motion(targets, about, len(means)), notes)
    if targets:
        notes.append("its animation is left out: it is not of tg4mm's making")
    return drawable(fields, notes)


def _ours(document: Document) -> dict[str, Any] | None:
    """Return tg4mm's own record of the splat in the document, or None for other writers."""
    nodes = [node for node in document.objects("nodes") if isinstance(node.get("extras"), dict)]
    told = [node["extras"]["tg4mm"] for node in nodes if "tg4mm" in node["extras"]]
    if len(told) != 1 or len(_splats(document)) != 1:
        return None
    about = told[0]
    good = isinstance(about, dict) and all(
        isinstance(about.get(key), list) and all(Number().fits(v) for v in about[key])
        for key in ("frequencies_hz", "alphas")
    )
    if not good or len(about["alphas"]) != len(about["frequencies_hz"]):
        raise SplatFileError(
            f"extras.tg4mm holds {str(about)[:60]}; expected frequencies_hz and alphas alike"
        )
    for key in ("fps", "unit_scale_m", "time_origin_s", "n_timesteps"):
        if about.get(key) is not None and not Number().fits(about[key]):
            raise SplatFileError(f"extras.tg4mm: {key} is {str(about[key])[:60]}; expected a finite number")
    if about.get("unit_scale_m") is not None and not about["unit_scale_m"] > 0:
        raise SplatFileError(f"extras.tg4mm: unit_scale_m is {about['unit_scale_m']}; expected more than 0")
    return {"unit_scale_m": None, **about}


def _motion(targets: list[np.ndarray], about: dict[str, Any], n: int) -> dict[str, Any]:
    """Modes from targets 2k and 2k + 1, the real and imaginary part of (1 + α_k) m_k; without those that α stopped."""
    alphas = np.array(about["alphas"], np.float64)
    if len(targets) != 2 * len(alphas) or any(len(t) != n for t in targets):
        raise SplatFileError(
            f"has {len(targets)} morph targets; {len(alphas)} modes have two each, of {n} points"
        )
    moving = np.flatnonzero(alphas != -1)
    parts = [(targets[2 * k] + 1j * targets[2 * k + 1]) / (1 + alphas[k]) for k in moving]
    displacement = np.array(parts, np.complex64).reshape(len(moving), n, 3)
    return {
        "freqs_hz": np.array(about["frequencies_hz"], np.float64)[moving],
        "displacement": displacement,
        "rotation": np.zeros_like(displacement),
        "fps": float(about.get("fps") or 0.0),
        "n_timesteps": int(about.get("n_timesteps") or 1),
        "time_origin_s": float(about.get("time_origin_s") or 0.0),
    }


def _joined(parts: list[SplatFile]) -> SplatFile:
    """One still scene of several, of the highest degree among them."""
    most = max(part.sh.shape[1] for part in parts)
    sh = [np.pad(part.sh, ((0, 0), (0, most - part.sh.shape[1]), (0, 0))) for part in parts]
    fields = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("means", "quats", "scales", "opacities")
    }
    return drawable(fields | {"sh": np.concatenate(sh)}, [note for part in parts for note in part.notes])
