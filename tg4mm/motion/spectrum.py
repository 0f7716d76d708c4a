"""The spectrum of a motion: temporal components and their fields to modes, one phasor per Gaussian and frequency."""

from __future__ import annotations

import numpy as np

from tg4mm.motion.sinusoids import TREND_CYCLES, Sinusoids, find_sinusoids

ALL_BINS_UP_TO = 64  # timesteps: of longer captures the weakest bins are dropped
_DROPPED = 1e-4  # of the motion's power at most, 1 % of its rms


def phasors(basis: np.ndarray, fields: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """`modes_of` with the fields applied: frequencies [K] in Hz and phasors [K, N, D] of Σ_r a_r(t) fields[r]."""
    freqs, series = modes_of(basis, fields, fps)
    return freqs, apply_series(series, fields)


def apply_series(series: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """[K, N, D] complex64: Σ_r series[k, r] fields[r] of temporal components' phasors [K, R] and fields [R, N, D]."""
    values = np.tensordot(series.astype(np.complex64), fields, axes=1)
    return np.asarray(values, np.complex64)


def modes_of(
    basis: np.ndarray, fields: np.ndarray, fps: float, appearance: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [K] in Hz, ascending, and phasors [K, R] of the temporal components a_r(t) of Σ_r a_r(t) fields[r].

    basis [R, T], fields [R, N, D], appearance [R, ...]: fields of colour that share the components.
    Σ_k Re[m_k exp(i 2π f_k t / fps)] reconstructs the motion at every timestep, less its mean over time, which is the
    rest pose. The frequencies are all DFT bins above 0. Where the motion has sinusoids between bins or a trend
    (`sinusoids.py`) these come on top, and the bins hold the residual: the sinusoids; a frequency of 0.05 bins, the
    trend from timestep 0 on; and 0 Hz, the offset from the mean over time to the motion's own zero, which is never
    magnified. Of more than 64 timesteps the weakest bins are dropped, 1e-4 of the power together; in it motion and
    appearance weigh the same.
    """
    n_timesteps = basis.shape[1]
    basis = basis - basis.mean(1, keepdims=True)
    products = np.einsum("rnc,snc->rs", fields[..., :3], fields[..., :3], dtype=np.float64)
    sinusoids = find_sinusoids(basis * np.sqrt(np.diag(products))[:, None])
    cycles, series = _with_bins(basis, sinusoids)
    if appearance is not None and (own := _products(appearance)).any():
        products = products / max(np.trace(products), 1e-30) + own / np.trace(own)
    power = np.einsum("kr,rs,ks->k", series.conj(), products, series).real
    keep = _worth_keeping(cycles, power) if n_timesteps > ALL_BINS_UP_TO else np.full(len(cycles), True)
    return cycles[keep] * fps / n_timesteps, series[keep]


def _products(values: np.ndarray) -> np.ndarray:
    """[R, R] float64: the inner products of R arrays."""
    flat = values.reshape(len(values), -1).astype(np.float64)
    return np.asarray(flat @ flat.T)


def _with_bins(basis: np.ndarray, sinusoids: Sinusoids) -> tuple[np.ndarray, np.ndarray]:
    """Cycles per capture [K], ascending, and phasors [K, R] of functions of time [R, T]."""
    n_timesteps = basis.shape[1]
    spectrum: dict[float, np.ndarray] = {}
    if len(sinusoids.cycles) or sinusoids.trend:
        x = sinusoids.regressors(n_timesteps)
        weights = np.linalg.lstsq(x, basis.T, rcond=None)[0]
        basis = basis - (x @ weights).T
        spectrum = _sinusoid_phasors(sinusoids, weights)
    bins = np.fft.rfft(basis, axis=1).T * (2 / n_timesteps)
    if n_timesteps % 2 == 0:
        bins[-1] /= 2  # the Nyquist bin has no mirror image
    for k in range(1, len(bins)):
        spectrum[k] = spectrum.get(k, 0) + bins[k]
    cycles = np.array(sorted(spectrum), np.float64)
    return cycles, np.stack([spectrum[c] for c in cycles])


def _sinusoid_phasors(sinusoids: Sinusoids, weights: np.ndarray) -> dict[float, np.ndarray]:
    """Phasors [R] by cycles per capture, from the weights [P, R] of the regressors."""
    n, first = len(sinusoids.cycles), 1 + sinusoids.trend
    out = {0.0: weights[0].astype(complex)}  # a cos + b sin = Re[(a − i b) exp(i …)]
    if sinusoids.trend:
        out[TREND_CYCLES] = -1j * weights[1]
    for j, cycle in enumerate(sinusoids.cycles):
        out[float(cycle)] = weights[first + j] - 1j * weights[first + n + j]
    return out


def _worth_keeping(cycles: np.ndarray, power: np.ndarray) -> np.ndarray:
    """[K] bool: all but the weakest bins, `_DROPPED` of the power together, from cycles and power [K]."""
    oscillates = np.flatnonzero(cycles >= 1)
    weakest = oscillates[np.argsort(power[oscillates])]
    small = np.cumsum(power[weakest]) <= _DROPPED * power[oscillates].sum()
    keep = np.full(len(cycles), True)
    keep[weakest[small]] = False
    return keep
