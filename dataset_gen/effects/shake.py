"""A camera that shakes: turns about its own centre over a record, of a stated rms shift of the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cameras import Camera
from ..cameras.hand import Tremor, rotation_matrix
from .warp import pixels_before

BAND_HZ = (1.0, 10.0)  # of hands and floors
_GRID = 16  # places per side of the picture at which shifts are measured


def turns(camera: Camera, size: int, shake_px: float, n_timesteps: int, fps: float, seed: int) -> np.ndarray:
    """Rotation vectors [T, 3], radians, camera axes (x right, y up, z back), of mean 0 over the record.

    The rms over the record and the picture of the shift that they cause is `shake_px`, for a picture `size` wide.
    Tremor as that of hands, in 1 … 10 Hz: its power falls as 1/f². Every camera index has its own.
    """
    tremor = Tremor.of((seed, 0x54A6, camera.index), fps, BAND_HZ)
    vectors = np.array([tremor.at(t / fps)[1] for t in range(n_timesteps)])
    vectors -= vectors.mean(0)
    small = 1e-3 / camera.focal(size)  # shifts are linear in turns as small as these
    shifts = np.array([_shift(camera, size, vector) for vector in small * np.eye(3)]) / small
    rms = np.sqrt((np.tensordot(vectors, shifts, 1) ** 2).sum(-1).mean())
    return np.asarray(shake_px / rms * vectors)


def largest_shift(camera: Camera, size: int, vectors: np.ndarray) -> float:
    """How far any place of the picture goes at most, pixels."""
    return max(float(np.linalg.norm(_shift(camera, size, vector), axis=-1).max()) for vector in vectors)


def turned(camera: Camera, vector: np.ndarray) -> Camera:
    """The camera turned about its own centre by a rotation vector [3] in its own axes."""
    pose = camera.camera_to_world.copy()
    pose[:3, :3] = pose[:3, :3] @ rotation_matrix(vector)
    return replace(camera, camera_to_world=pose)


def _shift(camera: Camera, size: int, vector: np.ndarray) -> np.ndarray:
    """[G, 2] pixels, over a grid of the picture up to its edges."""
    edge = np.linspace(0.0, size, _GRID)
    places = np.stack(np.meshgrid(edge, edge), -1).reshape(-1, 2)
    return pixels_before(camera, size, vector, places) - places
