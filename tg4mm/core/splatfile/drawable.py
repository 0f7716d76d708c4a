"""Shared code of splat file readers: stored values to a SplatFile, without undrawable Gaussians."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import SplatFileError
from .model import SH_COUNTS, SplatFile

Decode = Callable[
    [bytes], np.ndarray
]  # a lossless WebP → [H, W, 4] uint8, first row at the top; raises ValueError


@dataclass(frozen=True)
class Options:
    """Options given by the caller who opens a file."""

    freqs_hz: tuple[float, ...] = ()  # of the modes of a PLY that lost the line which says them
    fps: float = 30.0  # Hz, of that motion
    decode: Decode | None = None  # of SOG's pictures; None: Pillow


@dataclass(frozen=True)
class Head:
    """The header of a file."""

    kind: str  # such as "PLY" or "SPZ 3"
    count: int  # Gaussians
    n_modes: int = 0  # whose frequencies it says
    n_lost: int = 0  # modes whose frequencies it does not say
    y_up: bool = False  # the format's axes, Y up, which reading turns to Z up; else they are as in the file


def parsed_frequencies(text: str) -> tuple[float, ...]:
    """`"5, 7.5"` as (5.0, 7.5), Hz. Raises SplatFileError naming what is no frequency."""
    found = []
    for word in text.replace(";", " ").replace(",", " ").split():
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not 0 <= value < math.inf:
            raise SplatFileError(
                f"frequencies {text!r}: {word!r} is none; expected numbers in Hz such as 5, 7.5"
            )
        found.append(value)
    return tuple(found)


ANTIALIASED = (
    "was trained anti-aliased, for renderers that fade what their low-pass widens: here, Gaussians that are small "
    "in the picture are too opaque"
)
_FIRST = ("means", "quats", "scales", "opacities", "sh")  # arrays with a row for each Gaussian
_SECOND = ("displacement", "rotation", "deviation")  # of each mode
_WORDS = {"means": "position", "quats": "rotation", "scales": "scale", "opacities": "opacity", "sh": "colour"}


def drawable(fields: dict[str, Any], notes: Sequence[str] = ()) -> SplatFile:
    """The SplatFile of `fields`, its arguments, without the Gaussians that hold NaN, infinity or no rotation.

    Arrays need not be float32; motion may be absent. Coefficients past degree 3 are cut off. What was done is added to
    `notes`. Raises SplatFileError where no Gaussian is left, or for what SplatFile refuses.
    """
    fields = {name: value for name, value in fields.items() if value is not None}
    n, told = len(fields["means"]), list(notes)
    if fields["sh"].shape[1] > SH_COUNTS[-1]:
        fields["sh"] = fields["sh"][:, : SH_COUNTS[-1]]
        told.append("its spherical harmonics of degree 4 are cut to degree 3")
    with np.errstate(over="ignore", invalid="ignore"):
        for name in _FIRST:
            fields[name] = np.ascontiguousarray(fields[name], np.float32)
    reasons = _reasons(fields)
    if reasons:
        keep = ~np.logical_or.reduce(list(reasons.values()))
        why = ", ".join(f"{reason} ({bad.sum():,})" for reason, bad in reasons.items())
        if not keep.any():
            raise SplatFileError(f"has nothing to draw: each of its {n:,} Gaussians has {why}")
        told.append(f"{n - keep.sum():,} of {n:,} Gaussians are left out, for {why}")
        fields |= {name: fields[name][keep] for name in _FIRST}
        fields |= {name: fields[name][:, keep] for name in _SECOND if name in fields}
    if "freqs_hz" not in fields:
        none = np.zeros((0, len(fields["means"]), 3), np.complex64)
        fields |= {"freqs_hz": np.zeros(0), "displacement": none, "rotation": none}
    return SplatFile(**fields, notes=tuple(told))


def _reasons(fields: dict[str, Any]) -> dict[str, np.ndarray]:
    """Yield the defects of Gaussians, each with a mask [N] of the affected ones."""
    found: dict[str, np.ndarray] = {}
    for name in (*_FIRST, *_SECOND):
        if name in fields and not np.isfinite(fields[name]).all():
            rest = tuple(i for i in range(fields[name].ndim) if i != (name in _SECOND))
            word = f"a {_WORDS.get(name, 'motion')} that is no finite number"
            bad = ~np.isfinite(fields[name]).all(axis=rest)
            found[word] = found[word] | bad if word in found else bad
    opacities = fields["opacities"]
    rules = {
        "a rotation of zero": ~fields["quats"].any(axis=1),
        "a scale below 0": (fields["scales"] < 0).any(axis=1),
        "an opacity outside 0 … 1": (opacities < 0) | (np.isfinite(opacities) & (opacities > 1)),
    }
    return found | {reason: bad for reason, bad in rules.items() if bad.any()}
