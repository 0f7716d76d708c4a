"""`truth/motion.npz` of a dataset: the exact motion of every vertex. Needs numpy alone."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.errors import CaptureError
from tg4mm.core.untrusted import read_npz

TRUTH_FILE = Path("truth") / "motion.npz"
_SAME_GAIN = 1e-6  # gains nearer than this to the exponentials are those, stored in single precision


@dataclass(frozen=True)
class TruthObject:
    """One object's mesh at rest and its exact motion, zero if it stands still."""

    name: str
    rest: np.ndarray  # [V, 3] float64, world space, scene units
    faces: np.ndarray  # [F, 3] int64
    modes: np.ndarray  # [K, V, 3] complex128, displacement phasors, scene units


@dataclass(frozen=True)
class Truth:
    """Displacement of vertex v at timestep t: Re Σ_k (1 + α magnified[k]) modes[k, v] gains[k, t].

    The gains are exp(i 2π f_k t / fps) unless a mode rings down or drifts.
    """

    freqs_hz: np.ndarray  # [K] float64
    objects: tuple[TruthObject, ...]
    fps: float  # Hz
    n_timesteps: int
    gains: np.ndarray | None = None  # [K, T] complex128; None: the exponentials
    magnified: np.ndarray | None = None  # [K] bool; None: all


def load_truth(root: Path, fps: float, n_timesteps: int) -> Truth:
    """Read `<root>/truth/motion.npz` (docs/conventions.md) of a dataset of `n_timesteps` at `fps`, without pickles.

    `gains` and `magnified` may be absent: then every mode is a sinusoid and magnified.

    Raises CaptureError naming the file and what is wrong with it: absent, torn, an array that is missing, of
    a wrong shape or not finite, a face that points past the vertices.
    """
    file = Path(root) / TRUTH_FILE
    if not file.is_file():
        raise CaptureError(f"{file} does not exist")
    if not file.resolve().is_relative_to(Path(root).resolve()):
        raise CaptureError(f"{file} leads out of the dataset's folder, to {file.resolve()}")
    try:
        arrays = read_npz(file)
    except (OSError, ValueError) as error:
        raise CaptureError(f"{file} is damaged or not an .npz of plain arrays: {error}") from None
    freqs = _array(file, arrays, "frequencies_hz", (None,), np.floating).astype(np.float64)
    if (freqs < 0).any():
        raise CaptureError(f"{file}: frequencies_hz holds {freqs.min():g} Hz, expected ≥ 0")
    names = _array(file, arrays, "objects", (None,), np.str_)
    objects = tuple(_object(file, arrays, i, str(name), len(freqs)) for i, name in enumerate(names))
    if not objects:
        raise CaptureError(f"{file}: objects is empty")
    gains, magnified = _time_laws(file, arrays, freqs, fps, n_timesteps)
    return Truth(freqs, objects, fps, n_timesteps, gains, magnified)


def _time_laws(
    file: Path, arrays: dict[str, np.ndarray], freqs: np.ndarray, fps: float, n_timesteps: int
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return (gains, magnified), None where they say no more than the frequencies do."""
    gains = magnified = None
    if "gains" in arrays:
        shape = (len(freqs), n_timesteps)
        gains = _array(file, arrays, "gains", shape, np.complexfloating).astype(np.complex128)
        plain = np.exp(2j * np.pi * np.outer(freqs, np.arange(n_timesteps)) / (fps or 1.0))
        gains = None if np.abs(gains - plain).max(initial=0.0) < _SAME_GAIN else gains
    if "magnified" in arrays:
        magnified = _array(file, arrays, "magnified", (len(freqs),), np.bool_)
        magnified = None if magnified.all() else magnified
    return gains, magnified


def _object(file: Path, arrays: dict[str, np.ndarray], i: int, name: str, n_modes: int) -> TruthObject:
    rest = _array(file, arrays, f"rest_{i}", (None, 3), np.floating).astype(np.float64)
    faces = _array(file, arrays, f"faces_{i}", (None, 3), np.integer).astype(np.int64)
    modes = _array(file, arrays, f"mode_{i}", (n_modes, len(rest), 3), np.complexfloating).astype(
        np.complex128
    )
    if faces.size and not 0 <= faces.min() <= faces.max() < len(rest):
        span = f"{faces.min()} to {faces.max()}, expected 0 to {len(rest) - 1}"
        raise CaptureError(f"{file}: faces_{i} ({name!r}) has vertices {span}")
    return TruthObject(name, rest, faces, modes)


def _array(
    file: Path, arrays: dict[str, np.ndarray], key: str, shape: tuple[int | None, ...], kind: Any
) -> np.ndarray:
    if key not in arrays:
        raise CaptureError(f"{file} has no {key}")
    array = arrays[key]
    fits = len(array.shape) == len(shape) and all(
        s is None or s == a for s, a in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = tuple("any" if s is None else s for s in shape)
        raise CaptureError(f"{file}: {key} has shape {array.shape}, expected {wanted}")
    if not np.issubdtype(array.dtype, kind):
        raise CaptureError(f"{file}: {key} has type {array.dtype}, expected {kind.__name__}")
    if np.issubdtype(kind, np.inexact) and not np.isfinite(array).all():
        raise CaptureError(f"{file}: {key} holds a value that is not finite")
    return array
