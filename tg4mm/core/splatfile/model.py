"""A splat file in memory: Gaussians with activated values, phasors of modes; its properties and header line."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from tg4mm.core.errors import SplatFileError

SH_COUNTS = (1, 4, 9, 16)  # K = (degree + 1)² for degree 0 to 3

# a lossless WebP → [H, W, 4] uint8, first row at the top; raises ValueError
Decode = Callable[[bytes], np.ndarray]
FORMAT_VERSION = 1
MARK = "comment tg4mm "
POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")  # zeros, there because viewers expect them
F_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
OPACITY = ("opacity",)
SCALE = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")

# exp and the sigmoid never give exactly 0 or 1, so these ends are written as the nearest that survives.
SMALLEST_SCALE = 1e-12  # scene units; written for anything smaller
OPACITY_MARGIN = 2.0**-24  # opacities are written between this and 1 minus this, the float32 next to 1

LINEAR = "is fitted to viewers that blend in linear light, as Blender does: others show it too dark"
ANTIALIASED = (
    "was trained anti-aliased, for renderers that fade what their low-pass widens: here, Gaussians that are small "
    "in the picture are too opaque"
)
_FIRST = ("means", "quats", "scales", "opacities", "sh")  # arrays with a row for each Gaussian
_SECOND = ("displacement", "rotation", "deviation")  # of each mode
_WORDS = {"means": "position", "quats": "rotation", "scales": "scale", "opacities": "opacity", "sh": "colour"}


@dataclass(frozen=True)
class SplatFile:
    """N Gaussians and M modes of motion (M = 0: a static scene). Conventions: docs/conventions.md.

    x(t, α) = x + Σ_k (1 + α·g_k) Re[m_k exp(i 2π f_k t / fps)], g_k = 1 for f_k inside the band, else 0.

    Raises SplatFileError on construction if a shape, a range or the finiteness of a value is wrong.
    """

    means: np.ndarray  # [N, 3] float32, scene units, the rest position x
    quats: np.ndarray  # [N, 4] float32, wxyz, as stored (normalise where used), never zero
    scales: np.ndarray  # [N, 3] float32, linear, scene units, at least 0
    opacities: np.ndarray  # [N] float32, 0..1
    sh: np.ndarray  # [N, K, 3] float32, K = (degree + 1)²
    freqs_hz: np.ndarray  # [M] float64
    displacement: np.ndarray  # [M, N, 3] complex64, scene units
    rotation: np.ndarray  # [M, N, 3] complex64, rotation vectors, radians, world axes
    fps: float = 0.0  # Hz; 0.0 if unknown, which only a static file may be
    n_timesteps: int = 1  # T
    unit_scale_m: float | None = None  # metres per scene unit; None if unknown
    time_origin_s: float = 0.0  # seconds at timestep 0, on the recording's clock
    # [M, N] float32, standard deviation of |m_k|, scene units; None: not known
    deviation: np.ndarray | None = None
    # of the training pictures' low-pass, what the scales hold; None: nothing said
    low_pass_px2: float | None = None
    linear: bool = False  # fitted to viewers that blend in linear light (show/export/linear.py)
    notes: tuple[str, ...] = ()  # of a file that was read: what was left out or changed, a line each

    @classmethod
    def static(
        cls,
        means: np.ndarray,
        quats: np.ndarray,
        scales: np.ndarray,
        opacities: np.ndarray,
        sh: np.ndarray,
        unit_scale_m: float | None = None,
    ) -> "SplatFile":
        """A scene in which nothing moves."""
        none = np.zeros((0, len(means), 3), np.complex64)
        return cls(means, quats, scales, opacities, sh, np.zeros(0), none, none, unit_scale_m=unit_scale_m)

    def __post_init__(self) -> None:
        self._check_shapes()
        self._check_values()
        self._check_times()

    def __len__(self) -> int:
        """N, the number of Gaussians."""
        return len(self.means)

    @property
    def n_modes(self) -> int:
        """M."""
        return len(self.freqs_hz)

    @property
    def sh_degree(self) -> int:
        """0 to 3."""
        return SH_COUNTS.index(self.sh.shape[1])

    def _check_shapes(self) -> None:
        n, m = self.means.shape[0], self.freqs_hz.shape[0]
        if n == 0:
            raise SplatFileError("a splat file needs at least one Gaussian, there are 0")
        expected = {
            "means": (n, 3),
            "quats": (n, 4),
            "scales": (n, 3),
            "opacities": (n,),
            "freqs_hz": (m,),
            "displacement": (m, n, 3),
            "rotation": (m, n, 3),
        }
        if self.deviation is not None:
            expected["deviation"] = (m, n)
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise SplatFileError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")
        if self.sh.ndim != 3 or self.sh.shape not in [(n, k, 3) for k in SH_COUNTS]:
            raise SplatFileError(f"sh has shape {self.sh.shape}, expected ({n}, 1 | 4 | 9 | 16, 3)")

    def _check_values(self) -> None:
        for name in (f.name for f in fields(self) if isinstance(getattr(self, f.name), np.ndarray)):
            if not all_finite(getattr(self, name)):
                bad = np.argwhere(~np.isfinite(getattr(self, name)))[0].tolist()
                raise SplatFileError(
                    f"{name}{bad} is {getattr(self, name)[tuple(bad)]}; expected finite numbers"
                )
        if self.scales.min() < 0:
            raise SplatFileError(f"scales reach down to {self.scales.min():g}; expected at least 0")
        if self.opacities.min() < 0 or self.opacities.max() > 1:
            raise SplatFileError(
                f"opacities span {self.opacities.min():g} to {self.opacities.max():g}; expected 0 to 1"
            )
        if self.deviation is not None and self.deviation.min(initial=0) < 0:
            raise SplatFileError(f"deviation reaches down to {self.deviation.min():g}; expected at least 0")
        zero = np.flatnonzero(_no_rotation(self.quats))
        if len(zero):
            raise SplatFileError(f"quats[{zero[0]}] is zero, as {len(zero)} are; expected a rotation")
        if self.n_modes and self.freqs_hz.min() < 0:
            raise SplatFileError(f"freqs_hz reach down to {self.freqs_hz.min():g}; expected at least 0 Hz")

    def _check_times(self) -> None:
        if not math.isfinite(self.fps) or self.fps < 0 or (self.n_modes and self.fps == 0):
            raise SplatFileError(f"fps is {self.fps:g}; expected a finite number above 0")
        if self.n_timesteps < 1:
            raise SplatFileError(f"n_timesteps is {self.n_timesteps}; expected at least 1")
        if self.unit_scale_m is not None and not 0 < self.unit_scale_m < math.inf:
            raise SplatFileError(f"unit_scale_m is {self.unit_scale_m:g}; expected a finite number above 0")
        if self.low_pass_px2 is not None and not 0 <= self.low_pass_px2 < math.inf:
            raise SplatFileError(
                f"low_pass_px2 is {self.low_pass_px2:g}; expected a finite number, at least 0"
            )
        if not math.isfinite(self.time_origin_s):
            raise SplatFileError(f"time_origin_s is {self.time_origin_s:g}; expected a finite number")


def all_finite(values: np.ndarray) -> bool:
    """Return whether all values are finite; the sum, which is not if one of them is not, costs no memory."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(values.sum())) or bool(np.isfinite(values).all())


def _no_rotation(quats: np.ndarray) -> np.ndarray:
    w, x, y, z = quats.T  # by columns: numpy reduces an axis of four ten times as slowly
    return np.asarray((w == 0) & (x == 0) & (y == 0) & (z == 0))


def f_rest(count: int) -> tuple[str, ...]:
    """Names of `count` further SH coefficients: channel-major, all of red, then green, then blue."""
    return tuple(f"f_rest_{i}" for i in range(count))


def f_dc(rgb: np.ndarray) -> np.ndarray:
    """Colour in 0..1 → coefficient of the constant harmonic."""
    return (rgb - 0.5) / 0.28209479177387814


def mode(k: int) -> tuple[str, ...]:
    """The twelve properties of mode k: displacement re, im, then rotation vector re, im; x, y, z each."""
    parts = ("re_", "im_", "re_r", "im_r")
    return tuple(f"mode_{k}_{part}{axis}" for part in parts for axis in "xyz")


def deviation(k: int) -> str:
    """The property of mode k that holds the standard deviation of its amplitude; a file has all of them or none."""
    return f"mode_{k}_sd"


def log_scale(scales: np.ndarray) -> np.ndarray:
    """Linear scale → log scale."""
    return np.log(np.maximum(scales.astype(np.float64), SMALLEST_SCALE))


def logit(opacities: np.ndarray) -> np.ndarray:
    """Opacity in 0..1 → logit."""
    p = np.clip(opacities.astype(np.float64), OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    return np.log(p) - np.log1p(-p)


def sigmoid(logits: np.ndarray) -> np.ndarray:
    """Logit → opacity in 0..1, without overflow for large negative logits."""
    e = np.exp(-np.abs(logits.astype(np.float64)))  # of ±infinity 0
    return np.where(logits >= 0, 1 / (1 + e), e / (1 + e))


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
                f"frequencies {text!r}: {word!r} is not a frequency; expected numbers of at least 0 in Hz, "
                "such as 5, 7.5"
            )
        found.append(value)
    return tuple(found)


def drawable(fields: dict[str, Any], notes: Sequence[str] = ()) -> SplatFile:
    """The SplatFile of `fields`, its arguments, without the Gaussians that hold NaN, infinity or no rotation.

    Arrays need not be float32; motion may be absent. Coefficients past degree 3 are cut off. What was done is added to
    `notes`. Raises SplatFileError where no Gaussian is left, or for what SplatFile refuses.
    """
    fields = {name: value for name, value in fields.items() if value is not None}
    n, said = len(fields["means"]), list(notes)
    if fields["sh"].shape[1] > SH_COUNTS[-1]:
        fields["sh"] = fields["sh"][:, : SH_COUNTS[-1]]
        said.append("its spherical harmonics of degree 4 are cut to degree 3")
    with np.errstate(over="ignore", invalid="ignore"):
        for name in _FIRST:
            fields[name] = np.asarray(fields[name], np.float32)
    reasons = _reasons(fields)
    if reasons:
        keep = ~np.logical_or.reduce(list(reasons.values()))
        why = ", ".join(f"{reason} ({bad.sum():,})" for reason, bad in reasons.items())
        if not keep.any():
            raise SplatFileError(f"has nothing to draw: each of its {n:,} Gaussians has {why}")
        said.append(f"{n - keep.sum():,} of {n:,} Gaussians are left out, for {why}")
        fields |= {name: fields[name][keep] for name in _FIRST}
        fields |= {name: fields[name][:, keep] for name in _SECOND if name in fields}
    if "freqs_hz" not in fields:
        none = np.zeros((0, len(fields["means"]), 3), np.complex64)
        fields |= {"freqs_hz": np.zeros(0), "displacement": none, "rotation": none}
    return SplatFile(**fields, notes=tuple(said))


def _reasons(fields: dict[str, Any]) -> dict[str, np.ndarray]:
    """Yield the defects of Gaussians, each with a mask [N] of the affected ones."""
    found: dict[str, np.ndarray] = {}
    for name in (*_FIRST, *_SECOND):
        if name in fields and not all_finite(fields[name]):
            rest = tuple(i for i in range(fields[name].ndim) if i != (name in _SECOND))
            word = f"a {_WORDS.get(name, 'motion')} that is no finite number"
            bad = ~np.isfinite(fields[name]).all(axis=rest)
            found[word] = found[word] | bad if word in found else bad
    opacities = fields["opacities"]
    rules = {
        "a rotation of zero": _no_rotation(fields["quats"]),
        "a scale below 0": np.logical_or.reduce([axis < 0 for axis in fields["scales"].T]),
        "an opacity outside 0 … 1": (opacities < 0) | (np.isfinite(opacities) & (opacities > 1)),
    }
    return found | {reason: bad for reason, bad in rules.items() if bad.any()}
