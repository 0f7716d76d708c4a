"""glTF 2.0 with KHR_gaussian_splatting, one .glb. The motion is exact in it, as morph targets with animated weights.

x(t) = x + Σ_k cos(ω_k t) Re[(1 + α_k) m_k] − sin(ω_k t) Im[(1 + α_k) m_k]: each mode is two morph targets. Their
weights stay within ±1, since programs clamp larger ones.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.splatfile.formula import y_up
from tg4mm.core.splatfile.ply import replacing

from ...core.colour import to_linear
from ...core.errors import SplatFileError
from ...core.splatfile.model import SplatFile

EXTENSION = "KHR_gaussian_splatting"
KEYS_PER_TIMESTEP = 4  # linear interpolation between keys errs by under 1 % at a sixth of the frame rate
_FLOAT, _POINTS, _VERTICES = 5126, 0, 34962  # constants of glTF
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_C0 = 0.28209479177387814  # of the constant spherical harmonic


class _Buffer:
    """The growing binary chunk, with an accessor for every array."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, vertices: bool = True, bounds: bool = False) -> int:
        """Append [n] or [n, 3 | 4] as float32; returns the number of its accessor."""
        with np.errstate(over="ignore"):
            array = np.ascontiguousarray(values, "<f4")
        if not np.isfinite(array).all():
            raise SplatFileError(f"a value of size {np.abs(values).max():g} is past float32's range, 3.4e38")
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.views.append({**view, "target": _VERTICES} if vertices else view)
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _FLOAT,
            "count": len(array),
        }
        accessor["type"] = _KINDS[1 if array.ndim == 1 else array.shape[1]]
        if bounds:
            columns = array.reshape(len(array), -1)
            accessor |= {"min": columns.min(0).tolist(), "max": columns.max(0).tolist()}
        self.accessors.append(accessor)
        self.data += array.tobytes()
        return len(self.accessors) - 1


def write_glb(path: str | Path, splat: SplatFile, alphas: np.ndarray | None = None) -> None:
    """Write a binary glTF: the scene at rest, and an animation of its T timesteps with mode k (1 + α_k) times as far.

    alphas [M], 0 by default. Axes are turned to Y up; the node's scale brings lengths to metres where the scale is
    known, else a scene unit is a metre. Left out: how Gaussians rotate as they move, and how sure the motion is.
    Replaces `path` in one step. Raises SplatFileError if the file cannot be written.
    """
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(_content(y_up(splat), np.zeros(splat.n_modes) if alphas is None else alphas))


def _content(splat: SplatFile, alphas: np.ndarray) -> bytes:
    buffer = _Buffer()
    primitive = {
        "mode": _POINTS,
        "attributes": _attributes(splat, buffer),
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    mesh: dict[str, Any] = {"name": "splat", "primitives": [primitive]}
    node: dict[str, Any] = {"name": "splat", "mesh": 0, "extras": {"tg4mm": _about(splat, alphas)}}
    if splat.unit_scale_m is not None:
        node["scale"] = [splat.unit_scale_m] * 3
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "tg4mm"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [mesh],
    }
    if splat.n_modes:
        modes = (1.0 + alphas)[:, None, None] * splat.displacement
        parts = [part for mode in modes for part in (mode.real, mode.imag)]
        primitive["targets"] = [{"POSITION": buffer.add(part, bounds=True)} for part in parts]
        mesh["weights"] = [0.0] * len(parts)
        document["animations"] = [_animation(splat, buffer)]
    document |= {"accessors": buffer.accessors, "bufferViews": buffer.views}
    document["buffers"] = [{"byteLength": len(buffer.data)}]
    return _glb(document, bytes(buffer.data))


def _attributes(splat: SplatFile, buffer: _Buffer) -> dict[str, int]:
    quats = splat.quats.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    linear = to_linear(splat.sh[:, 0].astype(np.float64) * _C0 + 0.5)
    attributes = {
        "POSITION": buffer.add(splat.means, bounds=True),
        "COLOR_0": buffer.add(np.column_stack([linear, splat.opacities])),  # for viewers that show points
        f"{EXTENSION}:ROTATION": buffer.add(quats[:, [1, 2, 3, 0]]),
        f"{EXTENSION}:SCALE": buffer.add(splat.scales),
        f"{EXTENSION}:OPACITY": buffer.add(splat.opacities),
    }
    for k in range(splat.sh.shape[1]):
        degree = int(k**0.5)
        name = f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k - degree * degree}"
        attributes[name] = buffer.add(splat.sh[:, k])
    return attributes


def _animation(splat: SplatFile, buffer: _Buffer) -> dict[str, Any]:
    keys = np.arange(KEYS_PER_TIMESTEP * splat.n_timesteps + 1) / (KEYS_PER_TIMESTEP * splat.fps)  # seconds
    turns = np.exp(2j * np.pi * keys[:, None] * splat.freqs_hz)  # [keys, M]
    weights = np.stack([turns.real, -turns.imag], axis=-1).reshape(-1)
    sampler = {
        "input": buffer.add(keys, vertices=False, bounds=True),
        "output": buffer.add(weights, vertices=False),
        "interpolation": "LINEAR",
    }
    channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    return {"name": "vibration", "samplers": [sampler], "channels": [channel]}


def _about(splat: SplatFile, alphas: np.ndarray) -> dict[str, Any]:
    """Describe the morph targets: 2k holds the real part of (1 + α_k) m_k, and 2k + 1 the imaginary part."""
    return {
        "fps": splat.fps or None,
        "n_timesteps": splat.n_timesteps,
        "frequencies_hz": [float(f) for f in splat.freqs_hz],
        "alphas": [float(a) for a in alphas],
        "unit_scale_m": splat.unit_scale_m,
        "time_origin_s": splat.time_origin_s,
    }


def _glb(document: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
