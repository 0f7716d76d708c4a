"""What the pass through the pictures found of every frame and Gaussian, in a byte for each number.

Jᵀ W (1 − Q Qᵀ W) r_f of N Gaussians takes 48 bytes for each frame, and most of it is noise. Kept are the Gaussians that
a picture shows, each in steps of a 127th of its own largest size over time, halves of the data apart. Rounding adds
some 1e-4 of the noise's variance, and less to a sum over a region, in which rounding errors average out.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from tg4mm.fit.motion.jacobian.packed import DOF

HALVES = 2
_STEPS = 127
_TINY = 1e-30  # of a step: less is 0


@dataclass(frozen=True)
class Sides:
    """The right-hand sides of F frames on one clock, for both halves of the data.

    Zero for Gaussians that `rows` lacks.
    """

    rows: np.ndarray  # [n] int32 of the Gaussians, ascending
    values: np.ndarray  # [2, F, n, 6] int8
    steps: np.ndarray  # [2, n, 6] float32: what a step of `values` is worth

    @staticmethod
    def of(sides: np.ndarray) -> "Sides":
        """From [2, F, N, 6]."""
        largest = np.zeros((len(sides), *sides.shape[2:]), np.float32)
        for half, own in enumerate(sides):
            for frame in own:
                np.maximum(largest[half], np.abs(frame), out=largest[half])
        rows = np.flatnonzero(largest.any((0, 2))).astype(np.int32)
        steps = largest[:, rows] / _STEPS
        values = np.empty((*sides.shape[:2], len(rows), DOF), np.int8)
        for half, own in enumerate(sides):
            inverse = np.divide(1, steps[half], out=np.zeros_like(steps[half]), where=steps[half] > _TINY)
            for f, frame in enumerate(own):
                values[half, f] = np.rint(frame[rows] * inverse)
        return Sides(rows, values, steps)

    def __len__(self) -> int:
        """F."""
        return self.values.shape[1]

    @property
    def nbytes(self) -> int:
        return self.rows.nbytes + self.values.nbytes + self.steps.nbytes

    def summed(self, motions: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """[2, F, K]: E · s_f of motions E [K, N, 6] that are zero but at the Gaussians `wanted` [m]."""
        mine = np.flatnonzero(np.isin(self.rows, wanted))
        own = motions[:, self.rows[mine]].astype(np.float64)
        out = np.empty((HALVES, len(self), len(motions)))
        for half, steps in enumerate(self.steps):
            flat = (own * steps[mine]).reshape(len(own), -1).astype(np.float32)
            for f, frame in enumerate(self.values[half]):
                out[half, f] = flat @ frame[mine].reshape(-1).astype(np.float32)
        return out

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """For a file."""
        return {f"rows_{name}": self.rows, f"values_{name}": self.values, f"steps_{name}": self.steps}

    @staticmethod
    def restored(arrays: Mapping[str, np.ndarray], name: str, n_frames: int, n_gaussians: int) -> "Sides":
        """From what `arrays` gave of so many frames and Gaussians. Raises ValueError for anything else."""
        rows = arrays.get(f"rows_{name}", np.zeros(0))
        of_rows = (HALVES, len(np.atleast_1d(rows)), DOF)
        wanted = {
            f"rows_{name}": (np.int32, of_rows[1:2]),
            f"values_{name}": (np.int8, (HALVES, n_frames, *of_rows[1:])),
            f"steps_{name}": (np.float32, of_rows),
        }
        check_arrays(arrays, wanted)
        if len(rows) and (rows[0] < 0 or rows[-1] >= n_gaussians or (np.diff(rows) <= 0).any()):
            raise ValueError(f"rows_{name} does not number {n_gaussians} Gaussians")
        return Sides(*(arrays[key] for key in wanted))


def check_arrays(
    arrays: Mapping[str, np.ndarray], wanted: Mapping[str, tuple[DTypeLike, tuple[int, ...]]]
) -> None:
    """Raises ValueError where one of them is not there, or of another type or shape."""
    for name, (kind, shape) in wanted.items():
        found = arrays.get(name)
        if found is None or found.dtype != kind or found.shape != shape:
            said = "absent" if found is None else f"{found.dtype} {found.shape}"
            raise ValueError(f"{name} is {said}, expected {np.dtype(kind)} {shape}")
