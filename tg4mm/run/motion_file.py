"""RUN/motion.safetensors: a motion's phasors as tensors, and back.

Of most runs the phasors of all K modes are R < 2K real fields (`motion/fields.py`): then these are stored, `fields`
[R, N, 6] float32 and `series` [K, R] complex128, 24 bytes for a Gaussian and field where the phasors take 48 for a
Gaussian and mode. Else `displacement` and `rotation` [K, N, 3] complex64, as every run had them before.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import RunError
from tg4mm.fit.motion.modes import AppearanceModes, ModalMotion, fields_of
from tg4mm.fit.motion.spectrum import apply_series
from tg4mm.run.checks import FIELDS, LIGHT, PHASORS, check_frequencies, check_tensors

_MOST_BYTES = 32 << 30  # of phasors: a small file can name many modes


def tensors_of(motion: ModalMotion) -> dict[str, Tensor]:
    """What the file holds."""
    tensors = {"freqs_hz": torch.tensor(np.asarray(motion.freqs_hz, dtype=np.float64))}
    fields, series = fields_of(motion)
    if len(fields) < 2 * len(motion.freqs_hz):
        tensors |= {"fields": torch.from_numpy(fields), "series": torch.from_numpy(series)}
    else:
        for name in PHASORS:
            tensors[name] = torch.from_numpy(np.asarray(getattr(motion, name), dtype=np.complex64))
    if (appearance := motion.appearance) is not None:
        values = appearance.shapes.astype(np.float32), appearance.series.astype(np.complex128)
        tensors |= {k: torch.from_numpy(v) for k, v in zip(LIGHT, values, strict=True)}
    return tensors


def motion_of(file: Path, tensors: Mapping[str, Tensor], clock: tuple[float, int]) -> ModalMotion:
    """The motion in a file's tensors; `clock`: fps and timesteps. Raises RunError for types, shapes and values."""
    kind = FIELDS if "fields" in tensors else PHASORS
    check_tensors(file, tensors, {"freqs_hz": torch.float64, **kind}, LIGHT)
    check_frequencies(file, tensors["freqs_hz"])
    arrays = {name: tensor.numpy() for name, tensor in tensors.items()}
    freqs = arrays["freqs_hz"]
    if kind is FIELDS:
        both = _applied(file, arrays["fields"], arrays["series"], len(freqs))
        shifts, turns = np.ascontiguousarray(both[..., :3]), np.ascontiguousarray(both[..., 3:])
    else:
        shifts, turns = arrays["displacement"], arrays["rotation"]
    appearance = AppearanceModes(*(arrays[name] for name in LIGHT)) if set(LIGHT) <= set(arrays) else None
    return ModalMotion(freqs, shifts, turns, *clock, appearance=appearance)


def _applied(file: Path, fields: np.ndarray, series: np.ndarray, n_modes: int) -> np.ndarray:
    """[K, N, 6] complex64."""
    if fields.ndim != 3 or fields.shape[2] != 6 or series.shape != (n_modes, len(fields)):
        raise RunError(
            f"{file}: fields {fields.shape} and series {series.shape}, expected [R, N, 6] and [{n_modes}, R]"
        )
    size = 48 * n_modes * fields.shape[1]
    if size > _MOST_BYTES:
        raise RunError(f"{file}: {n_modes} modes of {fields.shape[1]} Gaussians would take {size >> 30} GiB")
    return apply_series(series, fields)
