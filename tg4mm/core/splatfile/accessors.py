"""A glTF document, .glb or .gltf: its JSON, and the arrays of numbers that it names."""

import base64
import binascii
import struct
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..errors import SplatFileError
from ..untrusted import parse_json
from ..values import Number

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
            told = f"{found.get('type')!r:.20} of {kind!r:.20}"
            raise SplatFileError(
                f"an accessor holds {told}; expected {width} numbers of a type that glTF knows"
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
            told = primitive.get("extensions", {})
            inner = told.get("KHR_gaussian_splatting", {}) if isinstance(told, dict) else None
            deeper = inner.get("extensions", {}) if isinstance(inner, dict) else None
            packed = list(deeper.values()) if isinstance(deeper, dict) else [None]
            objects([primitive.get("attributes", {}), told, inner, deeper, *packed], "a primitive")
