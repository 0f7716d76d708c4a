"""From functions of time and shapes in space to phasors, one per Gaussian and frequency."""

from __future__ import annotations

import numpy as np

from tg4mm.motion.temporal.tones import SLOW_TURN, Tones, found_tones

ALL_BINS_UP_TO = 64  # timesteps: of longer captures the weakest bins are left out
_LEFT_OUT = 1e-4  # of the motion's power, at most: 1 % of its rms


def phasors(basis: np.ndarray, shapes: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """`modes` as phasors: frequencies [K] in Hz and, of Σ_r a_r(t) shapes[r], [K, N, D] complex64."""
    freqs, series = modes(basis, shapes, fps)
    return freqs, of_shapes(series, shapes)


def of_shapes(series: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """[K, N, D] complex64: what phasors [K, R] of functions of time make of shapes [R, N, D]."""
    values = np.tensordot(series.astype(np.complex64), shapes, axes=1)
    return np.asarray(values, np.complex64)


def modes(
    basis: np.ndarray, shapes: np.ndarray, fps: float, light: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [K] in Hz, ascending, and phasors [K, R] of the functions of time of Σ_r a_r(t) shapes[r].

    basis [R, T], shapes [R, N, D], light [R, ...] what else goes with those functions.
    Σ_k Re[m_k exp(i 2π f_k t / fps)] gives the motion back at every timestep; only
    its mean over time is left out, which is where the Gaussians lie. The frequencies are all DFT bins above 0. Where
    the motion has tones between them or drifts (`tones.py`) there are besides: the tones, of which the bins then hold
    what is left; a frequency of 0.05 bins, which is the drift from timestep 0 on; and 0 Hz, the way from the mean over
    time to the motion's own zero, which no α should magnify. Of more than 64 timesteps the bins that hold next to
    nothing are left out, 1e-4 of the power together, in which all light weighs as much as all motion.
    """
    n_timesteps = basis.shape[1]
    basis = basis - basis.mean(1, keepdims=True)
    products = np.einsum("rnc,snc->rs", shapes[..., :3], shapes[..., :3], dtype=np.float64)
    tones = found_tones(basis * np.sqrt(np.diag(products))[:, None])
    cycles, series = _with_bins(basis, tones)
    if light is not None and (own := _products(light)).any():
        products = products / max(np.trace(products), 1e-30) + own / np.trace(own)
    power = np.einsum("kr,rs,ks->k", series.conj(), products, series).real
    keep = _worth_keeping(cycles, power) if n_timesteps > ALL_BINS_UP_TO else np.full(len(cycles), True)
    return cycles[keep] * fps / n_timesteps, series[keep]


def _products(values: np.ndarray) -> np.ndarray:
    """[R, R] float64: the inner products of R arrays."""
    flat = values.reshape(len(values), -1).astype(np.float64)
    return np.asarray(flat @ flat.T)


def _with_bins(basis: np.ndarray, tones: Tones) -> tuple[np.ndarray, np.ndarray]:
    """Cycles per capture [K], ascending, and phasors [K, R] of functions of time [R, T]."""
    n_timesteps = basis.shape[1]
    spectrum: dict[float, np.ndarray] = {}
    if len(tones.cycles) or tones.trend:
        x = tones.regressors(n_timesteps)
        weights = np.linalg.lstsq(x, basis.T, rcond=None)[0]
        basis = basis - (x @ weights).T
        spectrum = _of_tones(tones, weights)
    bins = np.fft.rfft(basis, axis=1).T * (2 / n_timesteps)
    if n_timesteps % 2 == 0:
        bins[-1] /= 2  # the Nyquist bin has no mirror image
    for k in range(1, len(bins)):
        spectrum[k] = spectrum.get(k, 0) + bins[k]
    cycles = np.array(sorted(spectrum), np.float64)
    return cycles, np.stack([spectrum[c] for c in cycles])


def _of_tones(tones: Tones, weights: np.ndarray) -> dict[float, np.ndarray]:
    """Phasors [R] by cycles per capture, from the weights [P, R] of the regressors."""
    n, first = len(tones.cycles), 1 + tones.trend
    out = {0.0: weights[0].astype(complex)}  # a cos + b sin = Re[(a − i b) exp(i …)]
    if tones.trend:
        out[SLOW_TURN] = -1j * weights[1]
    for j, cycle in enumerate(tones.cycles):
        out[float(cycle)] = weights[first + j] - 1j * weights[first + n + j]
    return out


def _worth_keeping(cycles: np.ndarray, power: np.ndarray) -> np.ndarray:
    """[K] bool: all but the weakest bins that hold next to nothing together, from cycles and power [K]."""
    oscillates = np.flatnonzero(cycles >= 1)
    weakest = oscillates[np.argsort(power[oscillates])]
    small = np.cumsum(power[weakest]) <= _LEFT_OUT * power[oscillates].sum()
    keep = np.full(len(cycles), True)
    keep[weakest[small]] = False
    return keep
