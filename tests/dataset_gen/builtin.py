"""The built-in scenes as their tests look at them: built once, solved once, and measures of a mesh."""

from functools import lru_cache

import numpy as np

from dataset_gen.prepare import bodies_of
from dataset_gen.scenes import SCENES
from dataset_gen.settings import motion_file
from dataset_gen.vibration import read_motion, solve


@lru_cache(maxsize=2)
def built(name):
    return SCENES[name]()


@lru_cache(maxsize=2)
def solved(name):
    """Mode shapes [K, V, 3] complex of every part, at 30 Hz."""
    bodies = bodies_of(built(name))
    motion = solve(read_motion(motion_file(name)), bodies, 30.0, None, 0)
    return {body.name: np.asarray(shape) for body, shape in zip(bodies, motion.shapes, strict=True)}


def volume(mesh):
    """Scene units cubed; above 0 for a closed mesh that faces outwards."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def open_edges(mesh):
    """Edges that are not walked once in each direction; positions decide, so that doubled seams count as joined."""
    _, same = np.unique(mesh.vertices.round(7), axis=0, return_inverse=True)
    t = same.reshape(-1)[mesh.triangles].astype(np.int64)
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    forth, back = (np.sort(edges @ k) for k in ([len(same), 1], [1, len(same)]))
    return len(np.setxor1d(forth, back))


def size(shape):
    """Largest |displacement| over the vertices of a complex mode shape [..., V, 3]."""
    return float(np.linalg.norm(np.abs(shape), axis=-1).max())
