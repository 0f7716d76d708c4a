"""Checks of a run's files: types, sizes and values, before anything computes with them.

The kernels trust the shapes of their arrays, and a time of NaN would be a wrong result in silence. All raise RunError
with the file, what was found and what was expected.

Of most runs the phasors of all K modes are sums of R < 2K real fields. Then RUN/motion.safetensors holds `fields`
[R, N, 6] float32 and `series` [K, R] complex128, 24 bytes for a Gaussian and field where the phasors take 48 for a
Gaussian and mode. Else it holds `displacement` and `rotation`, [K, N, 3] complex64.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import RunError
from tg4mm.core.values import Number, require
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import AppearanceModes, ModalMotion, fields_of

GAUSSIANS = dict.fromkeys(("means", "quats", "scales", "opacities", "sh"), torch.float32)
LIGHT = {"light_shapes": torch.float32, "light_series": torch.complex128}  # of a motion, both or none
# of a motion, one or the other
PHASORS = {"displacement": torch.complex64, "rotation": torch.complex64}
FIELDS = {"fields": torch.float32, "series": torch.complex128}
_NUMBERS = {torch.float32, torch.float64, torch.complex64, torch.complex128}
_FASTEST = 1e9  # Hz
_LONGEST = 1_000_000  # timesteps: nine hours at 30 Hz
_MOST_BYTES = 32 << 30  # of phasors, as an export holds them: a small file can name many modes


def check_finite(file: Path, tensors: Mapping[str, Tensor], also: Collection[torch.dtype] = ()) -> None:
    """Raise RunError unless all are finite floating-point numbers, or of the types in `also`."""
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
    """Raise RunError unless the tensors of `types` have those types and are finite; of `optional` all or none."""
    every = {**types, **(optional or {})}
    if set(tensors) not in (set(types), set(every)):
        raise RunError(f"{file} holds the tensors {sorted(tensors)}, expected {sorted(types)}")
    for name, tensor in tensors.items():
        if tensor.dtype != every[name]:
            raise RunError(f"{file}: {name} is {tensor.dtype}, expected {every[name]}")
    check_finite(file, tensors)


def check_times(path: Path, dataset: Path, of_run: tuple[float, int], of_dataset: tuple[float, int]) -> None:
    """Raise RunError if the dataset has other frames per second or timesteps (fps, T) than the run."""
    if of_run != of_dataset:
        raise RunError(
            f"{path} was trained on {of_run[1]} timesteps at {of_run[0]:g} Hz, but {dataset} holds {of_dataset[1]} at "
            f"{of_dataset[0]:g} Hz: train again into another folder"
        )


def check_readout(path: Path, dataset: Path, figures: Mapping[str, Any], readout_s: float) -> None:
    """Raise RunError if the dataset's rows have another readout time than in the run's motion stage."""
    of_run = figures.get("readout_s", 0.0)
    if of_run != readout_s:
        raise RunError(
            f"{path} was trained with a readout of {1e3 * of_run:g} ms, but {dataset} says {1e3 * readout_s:g} ms: "
            "train again into another folder"
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
    """Return fps and n_timesteps of a motion's header."""
    for name, most in (("fps", _FASTEST), ("n_timesteps", _LONGEST)):
        require(f"{file}: {name}", header.get(name), Number(0, most, above=True), RunError)
    if header["n_timesteps"] != int(header["n_timesteps"]):
        raise RunError(f"{file}: n_timesteps is {header['n_timesteps']!r}, expected a whole number")
    return float(header["fps"]), int(header["n_timesteps"])


def check_frequencies(file: Path, freqs_hz: Tensor) -> None:
    """A list [K] of Hz, none below 0."""
    if freqs_hz.ndim != 1 or bool((freqs_hz < 0).any()):
        raise RunError(f"{file}: freqs_hz is {freqs_hz.tolist()!r:.60}, expected a list of Hz, none below 0")


def check_uncertainty(file: Path, tensors: Mapping[str, Tensor], n: int) -> None:
    """float32: standard deviations `displacement` [n], and if there, `noise` [n] and `covariance` [n, 3, 3]."""
    for name, shape in (("displacement", (n,)), ("noise", (n,)), ("covariance", (n, 3, 3))):
        found = tensors.get(name)
        if found is None and name != "displacement":
            continue
        if found is None or found.dtype != torch.float32 or tuple(found.shape) != shape:
            shown = "absent" if found is None else f"{found.dtype} {tuple(found.shape)}"
            raise RunError(f"{file}: {name} is {shown}, expected float32 {shape}")
        if len(shape) == 1 and bool((found < 0).any()):
            raise RunError(f"{file}: {name} holds {float(found.min()):g}, expected at least 0")


def tensors_of(motion: ModalMotion) -> dict[str, Tensor]:
    """Return the file's tensors."""
    tensors = {"freqs_hz": torch.tensor(np.asarray(motion.freqs_hz, dtype=np.float64))}
    fields, series = motion.fields, motion.series
    if len(fields) >= 2 * len(series):
        fields, series = fields_of(motion)
    values = {"fields": fields, "series": series}
    if len(fields) >= 2 * len(series):
        values = {"displacement": motion.displacement, "rotation": motion.rotation}
    tensors |= {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in values.items()}
    if (appearance := motion.appearance) is not None:
        light = appearance.shapes.astype(np.float32), appearance.series.astype(np.complex128)
        tensors |= {k: torch.from_numpy(v) for k, v in zip(LIGHT, light, strict=True)}
    return tensors


def motion_of(file: Path, tensors: Mapping[str, Tensor], clock: tuple[float, int]) -> ModalMotion:
    """Return the motion in a file's tensors; `clock`: fps and timesteps. Raises RunError for invalid tensors."""
    kind = FIELDS if "fields" in tensors else PHASORS
    check_tensors(file, tensors, {"freqs_hz": torch.float64, **kind}, LIGHT)
    check_frequencies(file, tensors["freqs_hz"])
    arrays = {name: tensor.numpy() for name, tensor in tensors.items()}
    appearance = AppearanceModes(*(arrays[name] for name in LIGHT)) if set(LIGHT) <= set(arrays) else None
    freqs, (fps, n_timesteps) = arrays["freqs_hz"], clock
    first, second = (arrays[name] for name in kind)
    if kind is FIELDS and first.ndim == 3 and (size := 48 * len(freqs) * first.shape[1]) > _MOST_BYTES:
        raise RunError(
            f"{file}: {len(freqs)} modes of {first.shape[1]} Gaussians would take {size >> 30} GiB"
        )
    make = ModalMotion if kind is FIELDS else ModalMotion.of_phasors
    try:
        return make(freqs, first, second, fps, n_timesteps, appearance=appearance)
    except ValueError as error:
        raise RunError(f"{file}: {error}") from None
