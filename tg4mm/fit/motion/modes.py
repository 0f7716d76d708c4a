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

    `appearance`, if any, changes the Gaussians' colours by the same modes, with the same gains g_k.

    A motion that is not a sum of sinusoids (ring-down, drift) has its own `gains` in place of the exponentials. Modes
    that are not `magnified` have g_k = 0 in any band.
    """

    freqs_hz: np.ndarray  # [K] float64
    displacement: np.ndarray  # [K, N, 3] complex64, scene units
    rotation: np.ndarray  # [K, N, 3] complex64, rotation vectors in radians, world axes
    fps: float  # Hz
    n_timesteps: int  # T
    gains: np.ndarray | None = None  # [K, T] complex128; None: the exponentials
    magnified: np.ndarray | None = None  # [K] bool; None: all above 0 Hz
    appearance: AppearanceModes | None = None  # changes of colour; None: there are none

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
        return replace(
            self,
            freqs_hz=self.freqs_hz[keep],
            displacement=self.displacement[keep],
            rotation=self.rotation[keep],
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
    k, n = motion.displacement.shape[:2]
    sizes = np.array([_rms(motion.displacement), _rms(motion.rotation)])
    weights = np.divide(1, sizes, out=np.zeros(2), where=sizes > 0).repeat(3)
    products = np.zeros((2 * k, 2 * k))
    for start in range(0, n, _AT_ONCE):
        rows = (_rows(motion, slice(start, start + _AT_ONCE)) * weights).reshape(
            2 * k, 6 * min(_AT_ONCE, n - start)
        )
        products += rows @ rows.T
    power, vectors = np.linalg.eigh(products)
    u = vectors[:, np.flatnonzero(power > power.max(initial=0) * tolerance**2)[::-1]]
    fields = np.empty((u.shape[1], n, 6), np.float32)
    for start in range(0, n, _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        fields[:, some] = np.tensordot(u.T, _rows(motion, some), axes=1)
    return fields, np.ascontiguousarray(u[:k] + 1j * u[k:])


def _rms(phasors: np.ndarray) -> float:
    """0 where nothing moves."""
    return float(np.sqrt(np.mean(np.abs(phasors) ** 2, dtype=np.float64))) if phasors.size else 0.0


def _rows(motion: ModalMotion, some: slice) -> np.ndarray:
    """Return [2K, n, 6] float64: real parts, then imaginary parts, of displacement and rotation."""
    both = np.concatenate([motion.displacement[:, some], motion.rotation[:, some]], axis=2)
    return np.concatenate([both.real, both.imag]).astype(np.float64)


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
