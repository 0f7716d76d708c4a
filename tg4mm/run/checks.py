"""What the files of a run may hold: types, sizes and numbers are checked before anything computes with them.

The kernels trust the shapes of their arrays, and a time of NaN would be a wrong result in silence. All raise RunError
with the file, what was found and what was expected.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from tg4mm.core.errors import RunError
from tg4mm.core.values import Number, require
from tg4mm.fit.gaussians import Gaussians

GAUSSIANS = dict.fromkeys(("means", "quats", "scales", "opacities", "sh"), torch.float32)
LIGHT = {"light_shapes": torch.float32, "light_series": torch.complex128}  # of a motion, both or none
# of a motion, one or the other (`motion_file.py`)
PHASORS = {"displacement": torch.complex64, "rotation": torch.complex64}
FIELDS = {"fields": torch.float32, "series": torch.complex128}
_NUMBERS = {torch.float32, torch.float64, torch.complex64, torch.complex128}
_FASTEST = 1e9  # Hz
_LONGEST = 1_000_000  # timesteps: nine hours at 30 Hz


def check_finite(file: Path, tensors: Mapping[str, Tensor], also: Collection[torch.dtype] = ()) -> None:
    """Floating-point numbers, or of the types in `also`, none of them NaN or infinite."""
    for name, tensor in tensors.items():
        if tensor.dtype not in _NUMBERS and tensor.dtype not in also:
            raise RunError(f"{file}: {name} is {tensor.dtype}, expected floating-point numbers")
        if not bool(torch.isfinite(torch.view_as_real(tensor) if tensor.is_complex() else tensor).all()):
            raise RunError(f"{file}: {name} holds a value that is not finite")


def check_tensors(
    file: Path,
    tensors: Mapping[str, Tensor],
    types: Mapping[str, torch.dtype],
    optional: Mapping[str, torch.dtype] | None = None,
) -> None:
    """The tensors named in `types`, of those types and finite; of `optional` all or none."""
    every = {**types, **(optional or {})}
    if set(tensors) not in (set(types), set(every)):
        raise RunError(f"{file} holds the tensors {sorted(tensors)}, expected {sorted(types)}")
    for name, tensor in tensors.items():
        if tensor.dtype != every[name]:
            raise RunError(f"{file}: {name} is {tensor.dtype}, expected {every[name]}")
    check_finite(file, tensors)


def check_times(path: Path, dataset: Path, of_run: tuple[float, int], of_dataset: tuple[float, int]) -> None:
    """Raises RunError where the dataset has other frames per second or timesteps (fps, T) than the run."""
    if of_run != of_dataset:
        raise RunError(
            f"{path} was trained on {of_run[1]} timesteps at {of_run[0]:g} Hz, but {dataset} holds {of_dataset[1]} at "
            f"{of_dataset[0]:g} Hz: train again into another folder"
        )


def gaussians_of(file: Path, tensors: Mapping[str, Tensor]) -> Gaussians:
    """Gaussians of GAUSSIANS: one or more, with scales of at least 0 and opacities in 0..1."""
    try:
        gaussians = Gaussians(**tensors)
    except (ValueError, IndexError) as error:  # a scalar has no first dimension
        raise RunError(f"{file}: {error}") from None
    if not len(gaussians):
        raise RunError(f"{file} holds no Gaussian")
    if float(gaussians.scales.min()) < 0:
        raise RunError(f"{file}: scales reach down to {float(gaussians.scales.min()):g}, expected at least 0")
    low, high = float(gaussians.opacities.min()), float(gaussians.opacities.max())
    if low < 0 or high > 1:
        raise RunError(f"{file}: opacities span {low:g} to {high:g}, expected 0 to 1")
    return gaussians


def clock_of(file: Path, header: Mapping[str, Any]) -> tuple[float, int]:
    """fps and n_timesteps of a motion's header."""
    for name, most in (("fps", _FASTEST), ("n_timesteps", _LONGEST)):
        require(f"{file}: {name}", header.get(name), Number(0, most, above=True), RunError)
    if header["n_timesteps"] != int(header["n_timesteps"]):
        raise RunError(f"{file}: n_timesteps is {header['n_timesteps']!r}, expected a whole number")
    return float(header["fps"]), int(header["n_timesteps"])


def check_frequencies(file: Path, freqs_hz: Tensor) -> None:
    """A list [K] of Hz, none below 0."""
    if freqs_hz.ndim != 1 or bool((freqs_hz < 0).any()):
        raise RunError(f"{file}: freqs_hz is {freqs_hz.tolist()!r:.60}, expected a list of Hz, none below 0")


def check_uncertainty(file: Path, found: Tensor | None, n: int) -> Tensor:
    """[n] float32."""
    if found is None or found.dtype != torch.float32 or tuple(found.shape) != (n,):
        shown = "absent" if found is None else f"{found.dtype} {tuple(found.shape)}"
        raise RunError(f"{file}: displacement is {shown}, expected float32 ({n},)")
    return found
