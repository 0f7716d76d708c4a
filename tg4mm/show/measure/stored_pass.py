"""Cache of the pass through the pictures, with a byte for each number, in RUN/residuals.safetensors.

Jᵀ W (1 − Q Qᵀ W) r_f of N Gaussians takes 48 bytes for each frame, and most of it is noise. Kept are the Gaussians that
a picture shows, each in steps of a 127th of its largest size over time, for each half of the data. Rounding adds some
1e-4 of the noise's variance, and less to a sum over a region, where rounding errors average out.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import DTypeLike

from tg4mm.core.errors import RunError
from tg4mm.core.values import check_form
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash

HALVES = 2
_STEPS = 127
_TINY = 1e-30  # smaller steps are 0
PART = "residuals"
_VERSION = 3  # a file of another version is made again
_MOST = 1 << 30  # bytes; more is not cached
_TYPES = torch.int8, torch.uint8, torch.int16, torch.int32, torch.float16
Wanted = Mapping[str, tuple[DTypeLike, tuple[int, ...]]]
_LOG = logging.getLogger("tg4mm")


@dataclass(frozen=True)
class RightHandSides:
    """The right-hand sides of F frames on one clock, for both halves of the data; 0 for Gaussians not in `rows`."""

    rows: np.ndarray  # [n] int32 indices of Gaussians, ascending
    values: np.ndarray  # [2, F, n, 6] int8
    steps: np.ndarray  # [2, n, 6] float32: the size of a step of `values`

    @staticmethod
    def of(right_hand_sides: np.ndarray) -> "RightHandSides":
        """Pack an array [2, F, N, 6]."""
        largest = np.zeros((len(right_hand_sides), *right_hand_sides.shape[2:]), np.float32)
        for half, own in enumerate(right_hand_sides):
            for frame in own:
                np.maximum(largest[half], np.abs(frame), out=largest[half])
        rows = np.flatnonzero(largest.any((0, 2))).astype(np.int32)
        steps = largest[:, rows] / _STEPS
        values = np.empty((*right_hand_sides.shape[:2], len(rows), DOF), np.int8)
        for half, own in enumerate(right_hand_sides):
            inverse = np.divide(1, steps[half], out=np.zeros_like(steps[half]), where=steps[half] > _TINY)
            for f, frame in enumerate(own):
                values[half, f] = np.rint(frame[rows] * inverse)
        return RightHandSides(rows, values, steps)

    def __len__(self) -> int:
        return self.values.shape[1]

    def summed(self, motions: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Return E · s_f [2, F, K] for motions E [K, N, 6] that are zero except at the Gaussians `wanted` [m]."""
        mine = np.flatnonzero(np.isin(self.rows, wanted))
        own = motions[:, self.rows[mine]].astype(np.float64)
        out = np.empty((HALVES, len(self), len(motions)))
        for half, steps in enumerate(self.steps):
            flat = (own * steps[mine]).reshape(len(own), -1).astype(np.float32)
            for f, frame in enumerate(self.values[half]):
                out[half, f] = flat @ frame[mine].reshape(-1).astype(np.float32)
        return out

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """Return the arrays for a file."""
        return {f"rows_{name}": self.rows, f"values_{name}": self.values, f"steps_{name}": self.steps}

    @staticmethod
    def restored(
        arrays: Mapping[str, np.ndarray], name: str, n_frames: int, n_gaussians: int
    ) -> "RightHandSides":
        """Restore from `arrays` for so many frames and Gaussians. Raises ValueError for anything else."""
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
        return RightHandSides(*(arrays[key] for key in wanted))


def check_arrays(arrays: Mapping[str, np.ndarray], wanted: Wanted) -> None:
    """Raise ValueError for an array that is absent or of another type or shape."""
    for name, (kind, shape) in wanted.items():
        found = arrays.get(name)
        if found is None or found.dtype != kind or found.shape != shape:
            shown = "absent" if found is None else f"{found.dtype} {found.shape}"
            raise ValueError(f"{name} is {shown}, expected {np.dtype(kind)} {shape}")


StoredArrays = tuple[dict[str, np.ndarray], list[RightHandSides]]


@dataclass(frozen=True)
class StoredPass:
    """The cache file of one run, valid for the Gaussians and the motion with which it was made."""

    run: Run
    model: str  # digest
    may_save: bool
    notes: list[str] = field(default_factory=list)

    @staticmethod
    def of(run: Run, may_save: bool) -> "StoredPass":
        return StoredPass(run, model_hash(run.path), may_save)

    @property
    def is_there(self) -> bool:
        """Return whether the run has such a file, for any model."""
        return self.run.has_part(PART)

    def load(self, wanted: Wanted, n_frames: Mapping[str, int], n_gaussians: int) -> StoredArrays | None:
        """Return the arrays `wanted`, by name, type and shape, and the sides of clocks of so many frames.

        None where they are absent, damaged, or belong to another model.
        """
        if not self.run.has_part(PART):
            return None
        try:
            tensors, header = self.run.load_part(PART, _TYPES)
        except RunError as error:
            _LOG.warning("%s; the pictures are read again", error)
            return None
        if header.get("model") != self.model or header.get("pass_version") != _VERSION:
            return None
        arrays = {name: tensor.numpy() for name, tensor in tensors.items()}
        try:
            check_form(header, {"notes": [str]})
            check_arrays(arrays, wanted)
            right_hand_sides = [
                RightHandSides.restored(arrays, name, n, n_gaussians) for name, n in n_frames.items()
            ]
        except ValueError as error:
            _LOG.warning("%s: %s; the pictures are read again", self.run.part_file(PART), error)
            return None
        self.notes[:] = header["notes"]
        return arrays, right_hand_sides

    def save(self, arrays: Mapping[str, np.ndarray], notes: Sequence[str]) -> None:
        """Write the arrays if requested and at most 1 GiB; a folder that cannot be written is not an error."""
        if not self.may_save or sum(a.nbytes for a in arrays.values()) > _MOST:
            return
        tensors = {k: torch.from_numpy(np.ascontiguousarray(v)) for k, v in arrays.items()}
        try:
            extra = {"model": self.model, "pass_version": _VERSION, "notes": list(notes)}
            self.run.save_part(PART, tensors, **extra)
        except OSError as error:
            _LOG.warning(
                "%s cannot be written (%s): every call reads the pictures again", PART, error.strerror
            )
