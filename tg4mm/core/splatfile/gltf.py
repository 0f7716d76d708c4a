"""Reading glTF 2.0 with KHR_gaussian_splatting: .glb, or .gltf with what lies beside it. Y up is turned to Z up.

Of a .glb that tg4mm wrote the motion comes back too: modes from morph targets (`show/export/gltf.py`), but not how
Gaussians turn as they move, which the format does not hold.
"""

import base64
import binascii
import math
import struct
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile.formula import TURN, rotation_matrices, transformed
from tg4mm.core.splatfile.model import Head, SplatFile, drawable
from tg4mm.core.splatfile.spz import read_spz
from tg4mm.core.untrusted import parse_json
from tg4mm.core.values import Number

EXTENSION = "KHR_gaussian_splatting"
SPZ = tuple(f"{EXTENSION}_compression_spz{version}" for version in ("", "_2"))
_DEEPEST = 64  # nodes in each other
_MOST_NODES = 10_000  # with splats

MAGIC = b"glTF"
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZE = Number(0, whole=True)  # bytes
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Document:
    """A glTF document. Every method raises SplatFileError, without the file's name, for what is not as it should be."""

    def __init__(self, path: Path) -> None:
        self.folder = path.parent
        data = path.read_bytes()
        self._chunk: bytes | None = None
        text = self._unpacked(data) if data.startswith(MAGIC) else data
        try:
            value = parse_json(text, finite=True)
        except (ValueError, UnicodeDecodeError) as error:
            raise SplatFileError(f"its JSON is not valid: {error}") from None
        if not isinstance(value, dict) or not isinstance(value.get("asset"), dict):
            raise SplatFileError("is JSON, but not glTF: it has no asset")
        self.json: dict[str, Any] = value
        _check_shapes(value)
        self._buffers: dict[int, bytes] = {}

    def _unpacked(self, data: bytes) -> bytes:
        """The JSON of a .glb; its binary chunk is kept."""
        if len(data) < 20:
            raise SplatFileError("is truncated: its header has no end")
        version, length, size, kind = struct.unpack_from("<III4s", data, 4)
        if version != 2 or kind != b"JSON":
            raise SplatFileError(f"is glTF of version {version}, or has no JSON first; expected version 2")
        if length != len(data) or 20 + size > length:
            problem = "truncated" if length > len(data) or 20 + size > len(data) else "too long"
            raise SplatFileError(f"is {problem}: {len(data)} bytes, expected {length}")
        rest = data[20 + size :]
        if len(rest) >= 8:
            size_2, kind_2 = struct.unpack_from("<I4s", rest)
            if kind_2 == b"BIN\0":
                if size_2 > len(rest) - 8:
                    raise SplatFileError(
                        f"is truncated: its binary chunk has {len(rest) - 8} bytes of {size_2}"
                    )
                self._chunk = rest[8 : 8 + size_2]
        return data[20 : 20 + size]

    def objects(self, name: str) -> list[dict[str, Any]]:
        """A list of objects at the top of the document, [] if it is not there."""
        found: list[dict[str, Any]] = self.json.get(name, [])
        return found

    def index(self, values: list[Any], number: Any, name: str) -> int:
        """`number`, if it is one of the places in `values`."""
        if not Number(0, len(values), below=True, whole=True).fits(number):
            raise SplatFileError(f"names {name} {str(number)[:40]!r}; there are {len(values)}")
        return number

    def accessor(self, number: Any) -> dict[str, Any]:
        """An accessor whose count is one."""
        accessors = self.objects("accessors")
        found = accessors[self.index(accessors, number, "accessor")]
        count = found.get("count")
        if not Number(1, whole=True).fits(count):
            raise SplatFileError(
                f"an accessor has the count {str(count)[:40]!r}; expected a whole number above 0"
            )
        return found

    def values(self, number: Any, width: int) -> np.ndarray:
        """[count, width] float32 of an accessor; whole numbers are normalised, to 0 … 1 or −1 … 1."""
        found = self.accessor(number)
        kind, count, start = found.get("componentType"), found["count"], found.get("byteOffset", 0)
        if "sparse" in found:
            raise SplatFileError("has a sparse accessor, which this reader does not know")
        if not isinstance(kind, int) or kind not in _TYPES or _WIDTHS.get(str(found.get("type"))) != width:
            held = f"{found.get('type')!r:.20} of {kind!r:.20}"
            raise SplatFileError(
                f"an accessor holds {held}; expected {width} numbers of a type that glTF knows"
            )
        dtype = np.dtype(_TYPES[kind])
        view = self.view(found.get("bufferView"))
        step = self.json["bufferViews"][found["bufferView"]].get("byteStride", width * dtype.itemsize)
        size = width * dtype.itemsize
        if not all(map(_SIZE.fits, (start, step))) or step < size:
            raise SplatFileError(
                f"an accessor starts at {str(start)[:40]} with a stride of {str(step)[:40]} bytes"
            )
        if start + (count - 1) * step + size > len(view):
            raise SplatFileError(
                f"is truncated: an accessor of {count} values needs more than its {len(view)} bytes"
            )
        array: np.ndarray = np.ndarray((count, width), dtype, view, start, (step, dtype.itemsize))
        if dtype.kind == "f":
            return array.astype(np.float32)
        return np.maximum(array / np.float32(np.iinfo(dtype).max), np.float32(-1))

    def view(self, number: Any) -> memoryview:
        """The bytes of a buffer view."""
        views = self.objects("bufferViews")
        found = views[self.index(views, number, "bufferView")]
        start, size = found.get("byteOffset", 0), found.get("byteLength")
        data = self._buffer(found.get("buffer"))
        if not all(map(_SIZE.fits, (start, size))):
            raise SplatFileError(f"a bufferView spans {str(size)[:40]} bytes from {str(start)[:40]}")
        if start + size > len(data):
            raise SplatFileError(f"is truncated: a bufferView ends at byte {start + size} of {len(data)}")
        return memoryview(data)[start : start + size]

    def _buffer(self, number: Any) -> bytes:
        buffers = self.objects("buffers")
        at = self.index(buffers, number, "buffer")
        if at not in self._buffers:
            self._buffers[at] = self._loaded(buffers[at].get("uri"))
        return self._buffers[at]

    def _loaded(self, uri: Any) -> bytes:
        """The bytes of a buffer: the .glb's own chunk, in the text, or in a file beside it."""
        if uri is None:
            if self._chunk is None:
                raise SplatFileError("has a buffer without a uri, and no binary chunk")
            return self._chunk
        if not isinstance(uri, str):
            raise SplatFileError(f"a buffer's uri is {str(uri)[:40]!r}; expected text")
        head, comma, text = uri.partition(",")
        if head.startswith("data:"):
            try:
                return base64.b64decode(text, validate=True) if comma and head.endswith(";base64") else b""
            except binascii.Error as error:
                raise SplatFileError(f"a buffer in its text is damaged: {error}") from None
        return beside(self.folder, unquote(uri)).read_bytes()


def beside(folder: Path, name: str) -> Path:
    """A file that a document names. Raises SplatFileError for a name that leads out of its folder."""
    parts = PurePosixPath(name.replace("\\", "/"))
    if not name or "\0" in name or ":" in name or parts.is_absolute() or ".." in parts.parts:
        raise SplatFileError(f"names the file {name[:60]!r}, which is not beside it")
    return folder / parts


def _check_shapes(document: dict[str, Any]) -> None:
    """Raises SplatFileError where a list of objects is something else; so that no reader has to ask."""

    def objects(values: Any, where: str) -> None:
        if not isinstance(values, list) or not all(isinstance(v, dict) for v in values):
            raise SplatFileError(f"{where} is {str(values)[:40]!r}; expected a list of objects")

    for name in ("scenes", "nodes", "meshes", "accessors", "bufferViews", "buffers"):
        objects(document.get(name, []), name)
    for node in (*document.get("scenes", []), *document.get("nodes", [])):
        for key in ("nodes", "children", "matrix", "rotation", "scale", "translation"):
            values = node.get(key, [])
            if not isinstance(values, list) or not all(type(v) in (int, float) for v in values):
                raise SplatFileError(f"a node's {key} is {str(values)[:40]!r}; expected a list of numbers")
    for mesh in document.get("meshes", []):
        objects(mesh.get("primitives", []), "primitives")
        for primitive in mesh.get("primitives", []):
            objects(primitive.get("targets", []), "targets")
            extensions = primitive.get("extensions", {})
            inner = extensions.get("KHR_gaussian_splatting", {}) if isinstance(extensions, dict) else None
            deeper = inner.get("extensions", {}) if isinstance(inner, dict) else None
            packed = list(deeper.values()) if isinstance(deeper, dict) else [None]
            objects([primitive.get("attributes", {}), extensions, inner, deeper, *packed], "a primitive")


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
    extension = primitive.get("extensions", {}).get(EXTENSION)
    if extension is None:
        return False
    kernel = extension.get("kernel", "ellipse")
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
    turn = rotation_matrices(numbers("rotation", [0.0, 0.0, 0.0, 1.0])[None, [3, 0, 1, 2]])[0]
    matrix = np.eye(4)
    matrix[:3, :3] = turn * numbers("scale", [1.0] * 3)
    matrix[:3, 3] = numbers("translation", [0.0] * 3)
    return matrix


def _gaussians(document: Document, primitive: dict[str, Any], about: dict[str, Any] | None) -> SplatFile:
    extension = primitive["extensions"][EXTENSION]
    for name in SPZ:
        if name in (packed := extension.get("extensions", {})):
            return read_spz(bytes(document.view(packed[name].get("bufferView"))), turn=False)
    attributes, notes = primitive.get("attributes", {}), []
    if (space := extension.get("colorSpace", "srgb_rec709_display")) != "srgb_rec709_display":
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
    extras = [node["extras"]["tg4mm"] for node in nodes if "tg4mm" in node["extras"]]
    if len(extras) != 1 or len(_splats(document)) != 1:
        return None
    about = extras[0]
    good = isinstance(about, dict) and all(
        isinstance(about.get(key), list) and all(Number().fits(v) for v in about[key])
        for key in ("frequencies_hz", "alphas")
    )
    if not good or len(about["alphas"]) != len(about["frequencies_hz"]):
        raise SplatFileError(
            f"extras.tg4mm holds {str(about)[:60]}; expected two lists of numbers of the same length, "
            "frequencies_hz and alphas"
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
