"""Exact ground truth: the complex mode of every vertex, and per pixel what its centre sees."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.pictures import exr

from . import tree
from .vibration import Body, Motion

_VECTORS = ("Normal", "Position", "Displacement")


def motion_arrays(bodies: Sequence[Body], motion: Motion, n_timesteps: int) -> dict[str, np.ndarray]:
    """Arrays of truth/motion.npz: displacement(t) = Re Σ_k (1 + α magnified_k) mode_k gains_k(t), scene units.

    The names are in the contract: objects [O], frequencies_hz [K] (0 of a drift), gains [K, T] complex128,
    exp(i 2π f_k t / fps) for a steady vibration, magnified [K] bool, and of object i rest_<i> [V, 3] float32,
    faces_<i> [F, 3] int32, mode_<i> [K, V, 3] complex64.
    """
    arrays: dict[str, np.ndarray] = {
        "objects": np.array([body.name for body in bodies], dtype=np.str_),
        "frequencies_hz": motion.frequencies_hz,
        "gains": motion.gains(n_timesteps),
        "magnified": motion.magnified,
    }
    for i, (body, shape) in enumerate(zip(bodies, motion.shapes, strict=True)):
        arrays[f"rest_{i}"] = body.vertices.astype(np.float32)
        arrays[f"faces_{i}"] = body.triangles.astype(np.int32)
        arrays[f"mode_{i}"] = shape.astype(np.complex64)
    return arrays


def write_motion(path: Path, bodies: Sequence[Body], motion: Motion, n_timesteps: int) -> None:
    """Writes truth/motion.npz; no pickles. The same motion gives the same bytes."""
    buffer = io.BytesIO()
    arrays: dict[str, Any] = motion_arrays(bodies, motion, n_timesteps)
    np.savez_compressed(buffer, **arrays)
    tree.write_bytes(path, buffer.getvalue())


def write_exr(path: Path, passes: dict[str, np.ndarray]) -> None:
    """Writes the data passes as a single-part EXR with the contract's channel names, ZIP, float32.

    Depth.V: planar z, 1e10 where the pixel centre sees nothing (every other channel is 0 there). Normal:
    smooth normal of the mesh, world axes. Position: world. Displacement: of the point seen, from rest.
    """
    channels = {"Depth.V": passes["Depth"]}
    for name in _VECTORS:
        for axis, letter in enumerate("XYZ"):
            channels[f"{name}.{letter}"] = passes[name][..., axis]
    with tree.whole(path) as temporary:
        exr.write(temporary, {name: np.asarray(values, np.float32) for name, values in channels.items()})


def read_exr(path: Path, size: tuple[int, int] | None = None) -> dict[str, np.ndarray]:
    """Depth [H, W] and Normal, Position, Displacement [H, W, 3] float32 of a truth file (of that width and height).

    Raises CaptureError for a file that is damaged or of another kind.
    """
    found = exr.channels(
        path, ["Depth.V", *(f"{name}.{letter}" for name in _VECTORS for letter in "XYZ")], size
    )
    return {"Depth": found[..., 0]} | {
        name: found[..., 1 + 3 * i : 4 + 3 * i] for i, name in enumerate(_VECTORS)
    }
