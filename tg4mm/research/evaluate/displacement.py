"""Errors of an estimated motion against the true one: displacement, direction, leak."""

from typing import Any

import numpy as np

from tg4mm.fit.motion.modes import ModalMotion

STATIC_BELOW = 0.01  # of the largest true motion: below it a Gaussian counts as standing still


def displacement_figures(
    estimated: ModalMotion, true: ModalMotion, weights: np.ndarray, unit_scale_m: float | None = None
) -> dict[str, Any]:
    """Figures of an estimated motion against the true one of the same Gaussians, weighted by `weights` [N].

    `relative_error`: rms over timesteps and Gaussians of (estimated − true), divided by the rms of the true.
    `rms_true`, `rms_estimated`, `rms_error`: those rms, scene units (and `…_mm` if `unit_scale_m` is known).
    `static_leak`: rms of the estimated motion of Gaussians that stand still (true rms below 1 % of the
    largest), relative to the rms of the true motion of the others; None if none of either is seen.
    `static_share`: their part of the weight. `per_frequency`: `frequency_figures`.
    Figures that divide by no motion are None. Raises ValueError if the three do not fit together.
    """
    weights = _check(estimated, true, weights)
    error2, true2, estimated2 = mean_squares(estimated, true)  # [N] each
    rms = {k: _rms(v, weights) for k, v in (("error", error2), ("true", true2), ("estimated", estimated2))}
    figures: dict[str, Any] = {
        "relative_error": _ratio(rms["error"], rms["true"]),
        **{f"rms_{k}": v for k, v in rms.items()},
        "static_leak": _leak(true2, estimated2, weights),
        "static_share": float(weights[_still(true2)].sum() / weights.sum()),
        "per_frequency": frequency_figures(estimated, true, weights, unit_scale_m),
    }
    return figures | _in_mm(rms, "rms_", unit_scale_m)


def frequency_figures(
    estimated: ModalMotion, true: ModalMotion, weights: np.ndarray, unit_scale_m: float | None = None
) -> list[dict[str, Any]]:
    """Compare both motions at each true frequency over the capture's timesteps.

    Both are projected on that frequency (their discrete-time Fourier sum over t = 0 … T−1), so an estimate
    whose bins do not hold the frequency is still compared fairly. Per frequency, over Gaussians:
    `amplitude_true`, `amplitude_estimated`: weighted rms of the phasor's length (peak displacement of a
    motion along a line), scene units and mm; `amplitude_ratio`: their ratio; `relative_error`: rms of the
    phasors' difference over the rms of the true ones; `phase_error_deg`: of the weighted correlation,
    positive where the estimate is ahead; `direction_error_deg`: angle between the phasor vectors, arccos
    |⟨true, estimated⟩| / (|true| |estimated|), as between lines (0 to 90°, blind to phase), mean with weights
    × |true|² over the Gaussians that the estimate moves; `static_leak`: as of `displacement_figures`, of what stands
    still at that frequency and of the phasors there; `mac`: modal assurance criterion, |Σ w a*·b|² /
    (Σ w |a|² Σ w |b|²), 1 where the shapes are alike but for one complex factor.
    """
    weights = _check(estimated, true, weights)
    rows = []
    for frequency in np.unique(true.freqs_hz):
        a, b = (_phasor_at(m, float(frequency)) for m in (true, estimated))  # [N, 3] each
        amplitude = {k: _rms((np.abs(v) ** 2).sum(1), weights) for k, v in (("true", a), ("estimated", b))}
        correlation = complex((weights * (a.conj() * b).sum(1)).sum())
        rows.append(
            {
                "frequency_hz": float(frequency),
                **{f"amplitude_{k}": v for k, v in amplitude.items()},
                "amplitude_ratio": _ratio(amplitude["estimated"], amplitude["true"]),
                "relative_error": _ratio(_rms((np.abs(a - b) ** 2).sum(1), weights), amplitude["true"]),
                "phase_error_deg": float(np.degrees(np.angle(correlation))) if correlation else None,
                "direction_error_deg": _mean_angle(a, b, weights),
                "static_leak": _leak((np.abs(a) ** 2).sum(1), (np.abs(b) ** 2).sum(1), weights),
                "mac": _mac(a, b, weights),
                **_in_mm(amplitude, "amplitude_", unit_scale_m),
            }
        )
    return rows


def _check(estimated: ModalMotion, true: ModalMotion, weights: np.ndarray) -> np.ndarray:
    weights = np.asarray(weights, dtype=np.float64)
    n = {
        "estimated": estimated.displacement.shape[1],
        "true": true.displacement.shape[1],
        "weights": len(weights),
    }
    if len(set(n.values())) != 1 or weights.ndim != 1:
        raise ValueError(f"numbers of Gaussians differ: {n}")
    times = {(m.fps, m.n_timesteps) for m in (estimated, true)}
    if len(times) != 1:
        raise ValueError(f"estimated and true motion have different (fps, timesteps): {sorted(times)}")
    if not ((weights >= 0).all() and weights.sum() > 0):
        raise ValueError(f"weights must be ≥ 0 and not all 0; their sum is {weights.sum():g}")
    return weights


def mean_squares(estimated: ModalMotion, true: ModalMotion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per Gaussian the mean over timesteps of |estimated − true|², |true|², |estimated|²: [N] each."""
    sums = np.zeros((3, true.displacement.shape[1]))
    for t in range(true.n_timesteps):
        # Not rounded to float32, as what is rendered is: errors far below the motion are measured too.
        b, a = (_displacement(m, t) for m in (estimated, true))
        sums += [((b - a) ** 2).sum(1), (a**2).sum(1), (b**2).sum(1)]
    error, truth, estimate = sums / true.n_timesteps
    return error, truth, estimate


def _displacement(motion: ModalMotion, t: int) -> np.ndarray:
    return np.tensordot(motion.gains_at(t), motion.displacement, axes=1).real


def _phasor_at(motion: ModalMotion, frequency: float) -> np.ndarray:
    """(2/T) Σ_t d(t) exp(−i 2π f t / fps), [N, 3]; 1/T at 0 Hz and half the frame rate, its own images."""
    t = np.arange(motion.n_timesteps)
    gains = np.stack([motion.gains_at(int(i)) for i in t], 1)  # [K, T]
    against = np.exp(-2j * np.pi * frequency / motion.fps * t)
    forward = (gains * against).mean(1)
    backward = (gains.conj() * against).mean(1)
    both = np.tensordot(forward, motion.displacement, 1) + np.tensordot(
        backward, motion.displacement.conj(), 1
    )
    alone = np.isclose(2 * frequency % motion.fps, 0)
    return both / 2 if alone else both


def _mean_angle(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> float | None:
    a2, b2 = (np.abs(a) ** 2).sum(1), (np.abs(b) ** 2).sum(1)
    seen = (weights * a2 > 0) & (b2 > 0)
    if not seen.any():
        return None
    a, b, a2, weights = a[seen], b[seen], a2[seen], (weights * a2)[seen]
    inner = (a.conj() * b).sum(1)
    across = b - a * (inner / a2)[:, None]
    # atan2, not acos: an angle near 0 keeps its digits.
    angle = np.arctan2(np.linalg.norm(across, axis=1), np.abs(inner) / np.sqrt(a2))
    return float(np.degrees((angle * weights).sum() / weights.sum()))


def _still(true2: np.ndarray) -> np.ndarray:
    return true2 <= STATIC_BELOW**2 * true2.max(initial=0.0)


def _leak(true2: np.ndarray, estimated2: np.ndarray, weights: np.ndarray) -> float | None:
    still = _still(true2)
    return _ratio(_rms(estimated2, weights * still), _rms(true2, weights * ~still))


def _mac(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> float | None:
    across = abs((weights * (a.conj() * b).sum(1)).sum()) ** 2
    own = (weights * (np.abs(a) ** 2).sum(1)).sum() * (weights * (np.abs(b) ** 2).sum(1)).sum()
    return float(across / own) if own > 0 else None


def _rms(squares: np.ndarray, weights: np.ndarray) -> float | None:
    total = weights.sum()
    return float(np.sqrt((squares * weights).sum() / total)) if total > 0 else None


def _ratio(numerator: float | None, denominator: float | None) -> float | None:
    return numerator / denominator if numerator is not None and denominator else None


def _in_mm(values: dict[str, float | None], prefix: str, unit_scale_m: float | None) -> dict[str, float]:
    if unit_scale_m is None:
        return {}
    return {f"{prefix}{k}_mm": v * unit_scale_m * 1000.0 for k, v in values.items() if v is not None}
