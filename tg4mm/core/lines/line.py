"""One line of a spectrum: a sinusoid that is steady, rings down, grows, or begins during the record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Line:
    """u_d(t) = e(t) Re[phasor_d exp(i 2π f t)] with the envelope e(t) = exp(−decay (t − from_s)), 0 before `start_s`.

    `from_s` is where e(t) is 1: the line's first moment, of one that grows the last; so amplitudes are the largest of
    the record. The covariance is of (f, decay, Re q [D], Im q [D]) with q = phasor exp(i 2π f middle_s), the phasor at
    the middle of the line's energy, where phase and frequency are not correlated; decay has 0 where it is held at 0.
    """

    hz: float
    decay_per_s: float  # negative: grows; 0: held at 0, since no test says otherwise
    phasor: np.ndarray  # [D] complex, units of the values, by the record's own clock
    covariance: np.ndarray  # [2 + 2D, 2 + 2D]
    from_s: float
    middle_s: float
    start_s: float | None  # where it begins in the record, None: before it
    change: str  # "steady", "decays", "grows", "begins" (and then lasts or decays), "untold"
    free_decay: tuple[float, float]  # the decay over the record and its deviation with it left free
    strength: float  # χ² of its amplitudes, of 2D degrees of freedom

    @property
    def hz_deviation(self) -> float:
        """Standard deviation of the frequency, Hz."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def amplitude(self) -> np.ndarray:
        """[D] zero to peak, where the envelope is largest."""
        return np.abs(self.phasor)

    @property
    def amplitude_deviation(self) -> np.ndarray:
        """[D] standard deviation of each amplitude; of one hidden in noise that of its parts."""
        return np.sqrt(self._quadrature(np.exp(1j * np.angle(self.middle_phasor))))

    @property
    def phase_deviation(self) -> np.ndarray:
        """[D] radians, π at most, at `middle_s`."""
        across = np.sqrt(self._quadrature(1j * np.exp(1j * np.angle(self.middle_phasor))))
        return np.minimum(across / np.maximum(self.amplitude, 1e-300), np.pi)

    @property
    def middle_phasor(self) -> np.ndarray:
        """[D] q of the class's docstring."""
        return np.asarray(self.phasor * np.exp(2j * np.pi * self.hz * self.middle_s))

    @property
    def damping(self) -> float | None:
        """Ratio of the critical, ζ = decay / √(decay² + (2π f)²); None unless it is told that the line decays."""
        if self.decay_per_s <= 0:
            return None
        return float(self.decay_per_s / np.hypot(self.decay_per_s, 2 * np.pi * self.hz))

    @property
    def damping_deviation(self) -> float | None:
        """Standard deviation of `damping`."""
        if (ratio := self.damping) is None:
            return None
        return float(ratio / self.decay_per_s * np.sqrt(self.covariance[1, 1]))

    def envelope(self, times_s: np.ndarray) -> np.ndarray:
        """[T], 1 at most in the record."""
        e = np.exp(-self.decay_per_s * (times_s - self.from_s))
        return e if self.start_s is None else np.where(times_s >= self.start_s, e, 0.0)

    def at(self, times_s: np.ndarray) -> np.ndarray:
        """[T, D] the line's own part of the series."""
        turning = self.envelope(times_s) * np.exp(2j * np.pi * self.hz * times_s)
        return np.asarray((turning[:, None] * self.phasor).real)

    def _quadrature(self, direction: np.ndarray) -> np.ndarray:
        """[D] variance of Re(q conj(direction))."""
        n = len(self.phasor)
        re, im = 2 + np.arange(n), 2 + n + np.arange(n)
        c, a, b = self.covariance, direction.real, direction.imag
        return np.maximum(a * a * c[re, re] + b * b * c[im, im] + 2 * a * b * c[re, im], 0)
