"""Figures of an estimated vibration against a true one: phasors of Gaussians and of pixels, as plain arrays."""

from typing import Any

import numpy as np

MOVES = 0.5  # of the largest true phasor: from there on something counts as moving
STILL = 0.02  # of the same: below it something stands still
FOUND_HZ = 0.03  # a mode this near to a true frequency is that frequency
FALSE_PEAK = 0.1  # of the weaker true peak: from there on a mode elsewhere is a false peak


def picture_flow(means: np.ndarray, vectors: np.ndarray, viewmat: np.ndarray, K: np.ndarray) -> np.ndarray:
    """[..., N, 2] pixels: where small displacements [..., N, 3] of points [N, 3] go in the picture.

    The derivative of the pinhole projection; points at or behind the camera's plane do not move.
    """
    x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).T
    moved = vectors @ viewmat[:3, :3].T
    near = z <= 1e-6
    z = np.where(near, 1.0, z)
    u = K[0, 0] * (moved[..., 0] - x / z * moved[..., 2]) / z
    v = K[1, 1] * (moved[..., 1] - y / z * moved[..., 2]) / z
    return np.where(near[:, None], 0, np.stack([u, v], -1))


def phasor_at(
    freqs_hz: np.ndarray,
    phasors: np.ndarray,
    frequency: float,
    duration_s: float,
    tolerance: float = FOUND_HZ,
) -> np.ndarray:
    """[N, D] complex: what modes [K, N, D] within `tolerance` of a frequency do there together.

    A mode beside the frequency counts by its mean over the capture, once the two turn with each other: modes that
    beat add up to what is seen. Zero where there is none.
    """
    near = np.flatnonzero(np.abs(freqs_hz - frequency) <= tolerance)
    turns = (freqs_hz[near] - frequency) * duration_s
    gains = np.exp(1j * np.pi * turns) * np.sinc(turns)
    return np.tensordot(gains, phasors[near], 1)


def rms(phasors: np.ndarray, weights: np.ndarray) -> float:
    """Root of the weighted mean of |phasor|², phasors [..., D] and weights [...]; 0 where no weight is."""
    total = weights.sum()
    return float(np.sqrt(((np.abs(phasors) ** 2).sum(-1) * weights).sum() / total)) if total > 0 else 0.0


def inner(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> complex:
    """Σ weights · ⟨a, b⟩ of phasors [..., D], conjugate-linear in `a`."""
    return complex(((a.conj() * b).sum(-1) * weights).sum())


def mac(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> float:
    """Modal assurance criterion |⟨a, b⟩|² / (⟨a, a⟩ ⟨b, b⟩) of complex shapes [..., D] (Allemang & Brown 1982)."""
    norms = inner(a, a, weights).real * inner(b, b, weights).real
    return abs(inner(a, b, weights)) ** 2 / norms if norms > 0 else 0.0


def comparison(estimated: np.ndarray, true: np.ndarray, weights: np.ndarray) -> dict[str, float]:
    """Estimated phasors [..., D] against true ones, weights [...].

    Over what moves by more than half the largest true phasor: `error`, rms of the difference after the best common
    phase over rms of the truth; `amplitude_ratio` of the two rms; `phase_deg`, by how much the estimate is ahead;
    `direction_deg`, mean angle between the two as lines, by |true|². `error_all`: as `error`, over everything, with
    the same phase. `mac`. `leak`: rms of the estimate where the truth is below 2 % of its largest, over the true
    rms of what moves.
    """
    size = np.linalg.norm(true, axis=-1)
    seen = weights > 0
    moves = weights * (size > MOVES * size[seen].max(initial=0.0))
    still = weights * (size < STILL * size[seen].max(initial=0.0))
    phase = float(np.angle(inner(true, estimated, moves)))
    aligned = estimated * np.exp(-1j * phase)
    return {
        "error": _ratio(rms(aligned - true, moves), rms(true, moves)),
        "amplitude_ratio": _ratio(rms(estimated, moves), rms(true, moves)),
        "phase_deg": float(np.degrees(phase)),
        "direction_deg": direction_deg(estimated, true, moves),
        "error_all": _ratio(rms(aligned - true, weights), rms(true, weights)),
        "mac": mac(estimated, true, weights),
        "leak": _ratio(rms(estimated, still), rms(true, moves)),
    }


def direction_deg(estimated: np.ndarray, true: np.ndarray, weights: np.ndarray) -> float:
    """Mean angle, 0 … 90°, between phasors [..., D] as lines, weighted by weights · |true|²; 90 where nothing moves."""
    estimated2, true2 = (np.abs(estimated) ** 2).sum(-1), (np.abs(true) ** 2).sum(-1)
    seen = (weights * true2 > 0) & (estimated2 > 0)
    if not seen.any():
        return 90.0
    cosine = np.abs((true.conj() * estimated).sum(-1))[seen] / np.sqrt(estimated2 * true2)[seen]
    return float(np.degrees(np.average(np.arccos(np.minimum(cosine, 1.0)), weights=(weights * true2)[seen])))


def false_peaks(
    freqs_hz: np.ndarray, amplitudes_px: np.ndarray, true_hz: list[float], weakest_px: float
) -> list[dict[str, float]]:
    """Modes that are no true frequency and larger in the picture than a tenth of the weaker true one, largest first.

    0 Hz is no vibration.
    """
    far = np.min(np.abs(np.asarray(freqs_hz)[:, None] - np.array(true_hz)), axis=1) > FOUND_HZ
    wrong = np.flatnonzero(far & (amplitudes_px > FALSE_PEAK * weakest_px) & (np.asarray(freqs_hz) > 0))
    order = wrong[np.argsort(-amplitudes_px[wrong])]
    return [{"frequency_hz": float(freqs_hz[k]), "amplitude_px": float(amplitudes_px[k])} for k in order]


def phase_errors_deg(found_deg: np.ndarray, true_deg: np.ndarray) -> np.ndarray:
    """[C] degrees, −180 … 180: differences after the best common phase, which the clips' own gauge leaves open."""
    turned = np.exp(1j * np.radians(np.asarray(found_deg) - np.asarray(true_deg)))
    return np.degrees(np.angle(turned * np.conj(turned.sum())))


def clip_phase_figures(found: dict[str, dict[str, Any]], truth: dict[str, Any]) -> list[dict[str, Any]]:
    """Errors of the clips' phases, found[camera][frequency in Hz] in degrees, for every true frequency found there.

    Clip c is ahead by phases[c] at the first frequency and by phases[c] · f / f₁ at another.
    """
    rows = []
    first = truth["f_hz"][0]
    for frequency in truth["f_hz"]:
        names, values = [], []
        for name, by_frequency in sorted(found.items()):
            near = [f for f in by_frequency if abs(float(f) - frequency) <= FOUND_HZ]
            if near:
                names.append(name)
                values.append(float(by_frequency[min(near, key=lambda f: abs(float(f) - frequency))]))
        if names:
            clips = [int(name.rpartition("_")[2]) for name in names]
            phases = np.array([truth["clips"]["phases"][c] for c in clips])
            errors = phase_errors_deg(np.array(values), np.degrees(phases * frequency / first))
            rows.append(
                {"frequency_hz": frequency, "errors_deg": dict(zip(names, errors.tolist(), strict=True))}
            )
    return rows


def _ratio(a: float, b: float) -> float:
    return a / b if b > 0 else float("inf") if a > 0 else 0.0
