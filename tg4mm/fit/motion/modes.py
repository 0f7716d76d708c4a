"""Modal motion, the motion stage's result: one complex displacement and rotation per Gaussian and frequency.

Appearance that changes with the motion (gloss, shadows, reflections) goes with it in the same modes.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import RunError
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.config import MotionConfig

# Largest change of a Gaussian's colour, display-referred. The change is linear only as far as the capture shows it;
# magnified, real appearance saturates (a highlight that has left does not get darker), so it is limited smoothly.
LIMIT = 0.1
_SH_0 = 1 / (2 * math.sqrt(math.pi))  # the constant spherical harmonic: coefficient to colour
ROUNDING = 1e-6  # of the motion's rms: what float32 does not hold
_AT_ONCE = 8192  # Gaussians, so that no second copy of all phasors in float64 is held


@dataclass(frozen=True)
class AppearanceModes:
    """Σ_r c_r(t) shapes[r], with c_r(t) = Σ_k Re[series[k, r] g_k(t)] and the gains g_k of the motion's own modes.

    A few fields and their temporal components, in place of a phasor per Gaussian and frequency: a tenth of the memory.
    """

    shapes: np.ndarray  # [R, N, K, 3] float32, changes of the coefficients of spherical harmonics, K = 1 or 4
    series: np.ndarray  # [F, R] complex128, one row for each frequency of the motion

    def coefficients(self, gains: np.ndarray) -> np.ndarray:
        """Return [R] float32: c_r for gains [F] complex, magnification included."""
        return np.asarray((np.asarray(gains) @ self.series).real, np.float32)

    def selected(self, keep: np.ndarray) -> "AppearanceModes":
        """Return only the modes `keep` [F] bool."""
        return replace(self, series=self.series[keep])

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Two [F] bool: whether the real part of mode k, its imaginary part, changes any colour."""
        return self.series.real.any(axis=1), self.series.imag.any(axis=1)

    def fits(self, n_frequencies: int, sh: tuple[int, ...]) -> bool:
        """Return whether shapes and types match a motion of so many frequencies and spherical harmonics [N, K', 3]."""
        if self.shapes.ndim != 4 or self.series.shape != (n_frequencies, len(self.shapes)):
            return False
        if self.shapes.dtype != np.float32 or self.series.dtype != np.complex128:
            return False
        _, n, count, channels = self.shapes.shape
        return (n, channels) == (sh[0], 3) and count in (1, 4) and count <= sh[1]


def apply_appearance(sh: Tensor, shapes: Tensor, coefficients: Tensor) -> Tensor:
    """Spherical harmonics [N, K', 3] with Σ_r coefficients[r] shapes[r] added to the first K ≤ K' coefficients.

    shapes [R, N, K, 3], coefficients [R]. The size s of a Gaussian's change, its norm over channels and coefficients in
    colours, becomes LIMIT · tanh(s / LIMIT).
    """
    change = torch.tensordot(coefficients, shapes, dims=1)
    size = torch.linalg.vector_norm(change.flatten(1), dim=1) * (_SH_0 / LIMIT)
    change = change * (torch.tanh(size) / size.clamp_min(1e-6))[:, None, None]
    out = sh.clone()
    out[:, : change.shape[1]] += change
    return out


@dataclass(frozen=True)
class ModalMotion:
    """x(t, α) = x + Σ_k (1 + α·g_k) Re[m_k exp(i 2π f_k t / fps)], g_k = 1 for f_k inside the band, else 0.

    The phasors m_k of K modes are sums of R real fields, m_k = Σ_r series[k, r] fields[r]: a fit finds few fields and
    up to T / 2 modes, so that all phasors of a large scene would take most of the memory.
    `appearance`, if any, changes the Gaussians' colours by the same modes, with the same gains g_k.

    A motion that is not a sum of sinusoids (ring-down, drift) has its own `gains` in place of the exponentials. Modes
    that are not `magnified` have g_k = 0 in any band.
    """

    freqs_hz: np.ndarray  # [K] float64
    fields: np.ndarray  # [R, N, 6] float32: displacement, scene units; rotation vector, radians; world axes
    series: np.ndarray  # [K, R] complex128
    fps: float  # Hz
    n_timesteps: int  # T
    gains: np.ndarray | None = None  # [K, T] complex128; None: the exponentials
    magnified: np.ndarray | None = None  # [K] bool; None: all above 0 Hz
    appearance: AppearanceModes | None = None  # changes of colour; None: there are none

    def __post_init__(self) -> None:
        """Raise ValueError for shapes that do not fit."""
        fields, series, k = self.fields.shape, self.series.shape, len(self.freqs_hz)
        if len(fields) != 3 or fields[2] != 6 or series != (k, fields[0]):
            raise ValueError(f"fields {fields} and series {series}, expected [R, N, 6] and [{k}, R]")

    @classmethod
    def of_phasors(
        cls,
        freqs_hz: np.ndarray,
        displacement: np.ndarray,
        rotation: np.ndarray,
        fps: float,
        n_timesteps: int,
        gains: np.ndarray | None = None,
        magnified: np.ndarray | None = None,
        appearance: AppearanceModes | None = None,
    ) -> "ModalMotion":
        """Return the motion of these phasors, [K, N, 3] complex: scene units, and radians about the world axes.

        Their real and imaginary parts become the fields. Raises ValueError for shapes that do not fit.
        """
        shape = displacement.shape
        if rotation.shape != shape or len(shape) != 3 or shape[2] != 3 or shape[0] != len(freqs_hz):
            raise ValueError(
                f"displacement has shape {shape}, rotation {rotation.shape}, expected [{len(freqs_hz)}, N, 3]"
            )
        both = np.concatenate([displacement, rotation], axis=2)
        parts = np.concatenate([both.real, both.imag]).astype(np.float32)
        moves = parts.any(axis=(1, 2))
        one = np.eye(shape[0], dtype=np.complex128)
        series = np.concatenate([one, 1j * one], axis=1)
        return cls(freqs_hz, parts[moves], series[:, moves], fps, n_timesteps, gains, magnified, appearance)

    @property
    def n_gaussians(self) -> int:
        """N."""
        return self.fields.shape[1]

    @property
    def displacement(self) -> np.ndarray:
        """Displacement phasors [K, N, 3] complex64, scene units: large, and made anew by each call."""
        return self._phasors(slice(0, 3))

    @property
    def rotation(self) -> np.ndarray:
        """Rotation phasors [K, N, 3] complex64, radians about the world axes: large, and made anew by each call."""
        return self._phasors(slice(3, 6))

    def _phasors(self, columns: slice) -> np.ndarray:
        out = np.empty((len(self.series), self.n_gaussians, 3), np.complex64)
        for k, row in enumerate(self.series):
            out[k] = self._sum(row)[:, columns]
        return out

    def displacement_of(self, k: int) -> np.ndarray:
        """Return mode k's displacement phasors [N, 3] complex64, scene units."""
        return self._sum(self.series[k])[:, :3]

    def rotation_of(self, k: int) -> np.ndarray:
        """Return mode k's rotation phasors [N, 3] complex64, radians about the world axes."""
        return self._sum(self.series[k])[:, 3:]

    def combined(self, factors: np.ndarray) -> np.ndarray:
        """Return the displacement phasors Σ_k factors[k] m_k, [N, 3] complex64, scene units."""
        return self._sum(factors @ self.series)[:, :3]

    def _sum(self, coefficients: np.ndarray) -> np.ndarray:
        """Return Σ_r coefficients[r] fields[r], [N, 6] complex64."""
        parts = np.stack([coefficients.real, coefficients.imag]).astype(np.float32)
        real, imaginary = np.tensordot(parts, self.fields, axes=1)
        return np.asarray(real + 1j * imaginary)

    def coefficients(self, gains: np.ndarray) -> np.ndarray:
        """Return [R] float32, the fields' factors Re[Σ_k gains[k] series[k, r]] for gains [K] complex."""
        return np.asarray((np.asarray(gains) @ self.series).real, np.float32)

    def powers(self, weights: np.ndarray | None = None) -> np.ndarray:
        """Return [K] float64, Σ_n weights[n] |displacement of mode k at n|², scene units²; weights [N], or all 1."""
        return np.einsum("kr,rs,ks->k", self.series, self.products(0, weights), self.series.conj()).real

    def products(self, first: int, weights: np.ndarray | None = None) -> np.ndarray:
        """Return [R, R] float64, inner products of the fields' columns `first` to first + 3 over the Gaussians."""
        out = np.zeros((len(self.fields),) * 2)
        for start in range(0, self.n_gaussians, _AT_ONCE):
            some = self.fields[:, start : start + _AT_ONCE, first : first + 3].astype(np.float64)
            rows = some if weights is None else some * np.asarray(weights)[start : start + _AT_ONCE, None]
            out += np.tensordot(rows, some, axes=([1, 2], [1, 2]))
        return out

    def gains_at(self, t: float) -> np.ndarray:
        """Return [K] complex128: exp(i 2π f_k t / fps), or the motion's own gains.

        Those are defined at whole timesteps: raises RunError for any other t.
        """
        if self.gains is None:
            return np.asarray(np.exp(2j * np.pi * np.asarray(self.freqs_hz) * t / self.fps))
        if t != int(t) or not 0 <= t < self.gains.shape[1]:
            raise RunError(
                f"timestep {t:g}: this motion is only defined at whole timesteps 0 … {self.gains.shape[1] - 1}"
            )
        return np.asarray(self.gains[:, int(t)])

    def is_magnified(self) -> np.ndarray:
        """Return [K] bool. By default all but 0 Hz, the offset from the rest pose to the motion's own zero."""
        return self.freqs_hz > 0 if self.magnified is None else self.magnified

    def selected(self, keep: np.ndarray) -> "ModalMotion":
        """Return only the modes `keep` [K] bool."""
        series = self.series[keep]
        used = series.any(axis=0)
        return replace(
            self,
            freqs_hz=self.freqs_hz[keep],
            fields=self.fields if used.all() else self.fields[used],
            series=series[:, used],
            gains=None if self.gains is None else self.gains[keep],
            magnified=None if self.magnified is None else self.magnified[keep],
            appearance=None if self.appearance is None else self.appearance.selected(keep),
        )


def fields_of(motion: ModalMotion, tolerance: float = ROUNDING) -> tuple[np.ndarray, np.ndarray]:
    """Fields [R, N, 6] float32, by falling strength, and series [K, R] complex128 of a motion's phasors.

    Fields: displacement (scene units) and rotation vector (radians). They are the principal components of the phasors'
    real and imaginary parts (Eckart & Young 1936), displacement and rotation each over its own rms; those of an rms of
    at most `tolerance` of the strongest one's are left out.
    """
    k = len(motion.freqs_hz)
    rows = np.concatenate([motion.series.real, motion.series.imag])  # [2K, R]
    products = np.zeros((2 * k, 2 * k))
    for first in (0, 3):
        own = rows @ motion.products(first) @ rows.T
        products += own / (np.trace(own) or 1.0)
    power, vectors = np.linalg.eigh(products)
    u = vectors[:, np.flatnonzero(power > power.max(initial=0) * tolerance**2)[::-1]]
    fields = np.tensordot((u.T @ rows).astype(np.float32), motion.fields, axes=1)
    return fields, np.ascontiguousarray(u[:k] + 1j * u[k:])


@dataclass(frozen=True)
class MotionFit:
    """Result of `fit_motion`: the scene at rest, its motion, its uncertainty, and the limits of the capture."""

    gaussians: Gaussians  # at rest; others than those given where large motion made them sharper
    motion: ModalMotion  # displacement and rotation phasors of every Gaussian
    uncertainty: dict[str, np.ndarray]  # RUN/uncertainty.safetensors (docs/conventions.md); may be empty
    figures: dict[str, Any]  # for the log
    notes: list[str] = field(default_factory=list)  # limits of the result, a line each
    config: MotionConfig = field(default_factory=MotionConfig)  # it was asked for with

    @property
    def undetermined_hz(self) -> tuple[float, ...]:
        """Frequencies at which a moving camera shows motion, but not which part stands still."""
        return tuple(self.figures.get("undetermined_hz", ()))
