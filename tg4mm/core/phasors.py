"""Phasors: those of a series over time; what many say as single figures: how far, which way, how far most of them."""

import numpy as np


def series_modes(series: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [K] Hz and phasors [K, …] complex64 of a series [T, …]: 0 Hz and all other DFT bins.

    Σ_k Re[m_k exp(i 2π f_k t / fps)] is the series at every timestep.
    """
    n = len(series)
    spectrum = np.fft.rfft(series, axis=0) * (2 / n)
    spectrum[0] /= 2
    if n % 2 == 0:
        spectrum[-1] /= 2  # the Nyquist bin has no mirror image
    return np.fft.rfftfreq(n, 1 / fps), spectrum.astype(np.complex64)


def peak_displacement(phasors: np.ndarray) -> np.ndarray:
    """Greatest |Re(m exp(iφ))| over φ of phasors [..., 3], scene units: the ellipse's long half axis."""
    power = (np.abs(phasors) ** 2).sum(-1)
    straight = np.abs((phasors**2).sum(-1))
    return np.sqrt(np.maximum(power + straight, 0.0) / 2)


def main_direction(phasors: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Unit vector [3] along which phasors [N, 3], weighted [N], move most; largest component positive."""
    scatter = np.einsum("n,na,nb->ab", weights, phasors, phasors.conj()).real
    direction = np.linalg.eigh(scatter)[1][:, -1]
    return direction * np.sign(direction[np.argmax(np.abs(direction))] or 1.0)


def scale_top(values: np.ndarray, weights: np.ndarray | None = None, share: float = 0.995) -> float:
    """Return the top of a colour scale: the value that `share` of the weight stays below, robust to outliers."""
    flat = values.ravel()
    weight = np.ones(flat.shape) if weights is None else weights.ravel()
    order = np.argsort(flat)
    total = np.cumsum(weight[order])
    if total.size == 0 or total[-1] <= 0:
        return 0.0
    return float(flat[order][min(np.searchsorted(total, share * total[-1]), flat.size - 1)])
