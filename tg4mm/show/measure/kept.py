"""What the pass through the pictures found, kept in the run's folder: RUN/residuals.safetensors."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import DTypeLike

from tg4mm.core.errors import RunError
from tg4mm.core.values import check_form
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash
from tg4mm.show.measure.sides import Sides, check_arrays

PART = "residuals"
_VERSION = 3  # a file of another is made anew
_MOST = 1 << 30  # bytes; what is more is found anew each time
_TYPES = torch.int8, torch.uint8, torch.int16, torch.int32, torch.float16
Wanted = Mapping[str, tuple[DTypeLike, tuple[int, ...]]]
Kept = tuple[dict[str, np.ndarray], list[Sides]]
_LOG = logging.getLogger("tg4mm")


@dataclass(frozen=True)
class KeptPass:
    """The file of one run, valid for the Gaussians and the motion that it was made with."""

    run: Run
    model: str  # digest
    may_save: bool
    notes: list[str] = field(default_factory=list)

    @staticmethod
    def of(run: Run, may_save: bool) -> "KeptPass":
        return KeptPass(run, model_hash(run.path), may_save)

    @property
    def is_there(self) -> bool:
        """Whether the run has such a file, of whatever model."""
        return self.run.has_part(PART)

    def load(self, wanted: Wanted, n_frames: Mapping[str, int], n_gaussians: int) -> Kept | None:
        """The arrays `wanted`, by name, type and shape, and the sides of the clocks of so many frames.

        None where there are none, or they belong to another model, or are damaged.
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
            sides = [Sides.restored(arrays, name, n, n_gaussians) for name, n in n_frames.items()]
        except ValueError as error:
            _LOG.warning("%s: %s; the pictures are read again", self.run.part_file(PART), error)
            return None
        self.notes[:] = header["notes"]
        return arrays, sides

    def save(self, arrays: Mapping[str, np.ndarray], notes: Sequence[str]) -> None:
        """Write the arrays if that was requested and they take at most 1 GiB.

        A folder that cannot be written is no error.
        """
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
