"""Combine clips: a vibration in x, y, z from cameras with independent clocks that see two directions each.

A steady vibration has one phasor p [3] at a frequency. Clip c shows it along its axes R_c (right, up, sight) with a
phase θ_c that all sensors share (frequency-domain triangulation: Gorjup, Slavič & Boltežar 2019):

    u_c  =  exp(iθ_c) R_c p  +  an error with the covariance C_c

u_c and C_c are those of a sinusoid fitted to the clip's series: its noise, and errors of the model that grow with the
motion. p of every sensor and all θ_c are estimated together by weighted least squares (Gauss-Newton). The phases from
the motion stage, for all Gaussians together, count as measurements of θ_c with Cauchy-distributed errors: mostly good,
sometimes far off. Deviations follow from the fit and grow with its residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.show.measure.series import UNSEEN, Series
from tg4mm.show.measure.spectrum import (
    Peak,
    Spectrum,
    floor_factor,
    frequency_grid,
    is_resolved,
    ordered,
    rayleigh,
    sinusoid_columns,
    spectrum_of,
    strength_of,
    transformed,
    with_harmonics,
)

PHASE_RAD = 0.1  # scale of the error of a phase by the motion stage (docs/protocol.md: 1°, 4°, 12°, once 71°)
_STARTS, _TURNS = 24, 60  # random phases, where none are known, and steps from each
_STEPS = 30  # of Gauss-Newton
_SAME = 0.75  # of 1 / duration: nearer than this two frequencies are one
_MOST = 8  # frequencies
_TINY = 1e-9  # of a covariance's trace, added along its diagonal


@dataclass(frozen=True)
class Rows:
    """One sensor on one clip: `seen` [m] = exp(iθ) `design` [m, 3] p + noise of unit variance."""

    design: np.ndarray
    seen: np.ndarray


def triangulated(
    rows: Sequence[Sequence[Rows]], known: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return phasors [S, 3] and their variances (of real and imaginary part), phases [C] and their deviations.

    rows [S][C]; known [C]: phases by the motion stage.
    """
    count, n = len(rows[0]), 3 * len(rows)
    theta = _phases_alone(rows) if known is None else known.copy()
    fixed = int(np.argmax([sum(float((abs(r[c].seen) ** 2).sum()) for r in rows) for c in range(count)]))
    free = [c for c in range(count) if c != fixed]
    p = _given(rows, theta)
    for _ in range(_STEPS):
        jacobian, left = _linearised(rows, p, theta, free, known)
        step = np.linalg.lstsq(jacobian, left, rcond=None)[0]
        p = p + (step[:n] + 1j * step[n : 2 * n]).reshape(-1, 3)
        theta[free] += step[2 * n :]
        if np.abs(step[2 * n :]).max(initial=0.0) < 1e-7:
            break
    jacobian, _ = _linearised(rows, p, theta, free, known)
    spread = np.diag(np.linalg.pinv(jacobian.T @ jacobian, rcond=UNSEEN**2))
    both = (spread[:n] + spread[n : 2 * n]).reshape(-1, 3) / 2
    variance = np.stack([_checked(own, p[s], both[s], theta) for s, own in enumerate(rows)])
    deviation = np.zeros(count)
    deviation[free] = np.sqrt(spread[2 * n :])
    p, theta = (p, theta) if known is not None else (p * np.exp(1j * theta[0]), theta - theta[0])
    return p, variance, (theta + np.pi) % (2 * np.pi) - np.pi, deviation


def _checked(rows: Sequence[Rows], phasor: np.ndarray, variance: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return the variance [3] of a sensor's phasor, scaled by the clips' disagreement; inf along unseen directions."""
    left = [r.seen - np.exp(1j * t) * (r.design @ phasor) for r, t in zip(rows, theta, strict=True)]
    total, free = sum(float((abs(e) ** 2).sum()) for e in left), 2 * sum(map(len, left)) - 6
    values, vectors = np.linalg.eigh(sum((r.design.T @ r.design for r in rows), np.zeros((3, 3))))
    hidden = (vectors[:, values <= UNSEEN * max(values[-1], 1e-300)] ** 2).sum(1)
    return np.where(hidden > 0.5, np.inf, variance * max(total / free if free > 0 else 1.0, 1.0))


def _given(rows: Sequence[Sequence[Rows]], theta: np.ndarray) -> np.ndarray:
    """Return phasors [S, 3] for known phases."""
    out = []
    for own in rows:
        design = np.concatenate([r.design for r in own])
        seen = np.concatenate([r.seen * np.exp(-1j * t) for r, t in zip(own, theta, strict=True)])
        out.append(np.linalg.lstsq(design.astype(complex), seen, rcond=UNSEEN)[0])
    return np.array(out).reshape(-1, 3)


def _phases_alone(rows: Sequence[Sequence[Rows]]) -> np.ndarray:
    """Return phases [C], estimated alternately with the phasors, from the best of many random starts."""
    rng, best, out = np.random.default_rng(0), -np.inf, np.zeros(len(rows[0]))
    for _ in range(_STARTS):
        theta = rng.uniform(0, 2 * np.pi, len(rows[0]))
        for _ in range(_TURNS):
            p = _given(rows, theta)
            shown = [[r.design @ p[s] for r in own] for s, own in enumerate(rows)]
            each = [
                [np.vdot(e, r.seen) for e, r in zip(*pair, strict=True)]
                for pair in zip(shown, rows, strict=True)
            ]
            products = np.array([sum(own) for own in zip(*each, strict=True)])
            theta = np.angle(products)
        if (score := float(np.abs(products).sum())) > best:
            best, out = score, theta
    return out


def _linearised(
    rows: Sequence[Sequence[Rows]],
    p: np.ndarray,
    theta: np.ndarray,
    free: Sequence[int],
    known: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Jacobian and the residual: real parts, imaginary parts, and the known phases.

    Unknowns: real parts of the phasors [3S], imaginary parts [3S], phases of the clips `free`.
    """
    n = 3 * len(rows)
    jacobian, left = [], []
    for s, own in enumerate(rows):
        for c, r in enumerate(own):
            turned = np.exp(1j * theta[c]) * r.design
            block = np.zeros((len(r.seen), 2 * n + len(free)), complex)
            block[:, 3 * s : 3 * s + 3], block[:, n + 3 * s : n + 3 * s + 3] = turned, 1j * turned
            if c in free:
                block[:, 2 * n + free.index(c)] = 1j * (turned @ p[s])
            rest = r.seen - turned @ p[s]
            jacobian += [block.real, block.imag]
            left += [rest.real, rest.imag]
    if known is not None:
        away = np.angle(np.exp(1j * (known - theta)))[list(free)]
        weight = 1 / np.sqrt(PHASE_RAD**2 + away**2)  # Cauchy's, by reweighting
        jacobian.append(np.concatenate([np.zeros((len(free), 2 * n)), np.diag(weight)], 1))
        left.append(weight * away)
    return np.concatenate(jacobian), np.concatenate(left)


@dataclass(frozen=True)
class KnownPhases:
    """Phases from the motion stage: radians by which clips are ahead of the first one's clock."""

    hz: np.ndarray  # [K]
    radians: np.ndarray  # [C, K]

    def at(self, frequency_hz: float, apart: float) -> np.ndarray | None:
        """Return the phases [C] at the nearest frequency, if it is within `apart` Hz."""
        if not len(self.hz):
            return None
        k = int(np.abs(self.hz - frequency_hz).argmin())
        return self.radians[:, k] if abs(self.hz[k] - frequency_hz) <= apart else None


@dataclass(frozen=True)
class ClipPhases:
    """Phases θ of clips, each of which shows Re[R_c p exp(i (2π f t + θ))] at its own time t."""

    clocks: tuple[str, ...]  # [C]
    hz: np.ndarray  # [K]
    radians: np.ndarray  # [C, K] θ
    deviation: np.ndarray  # [C, K]


@dataclass(frozen=True)
class Together:
    """The combined result of all clips for one sensor."""

    spectrum: Spectrum  # along the world's x, y, z
    everywhere: tuple[Peak, ...]  # [K] at every frequency of any sensor, above the floor or not
    of_clips: tuple[tuple[Peak, ...], ...]  # [C][peaks of `spectrum`] along each series' axes, on its clock


def together(
    sensors: Sequence[Sequence[Series]], known: KnownPhases, shared: Sequence[float]
) -> tuple[list[Together], ClipPhases]:
    """Combine series by sensor and clip [S][C].

    shared [S]: standard deviation of an error common to all clips (the run's Gaussians), scene units rms.
    """
    hz, deviation = _frequencies(sensors, known)
    phasors = [[_phasors(series, hz) for series in own] for own in sensors]
    count = len(sensors[0])
    found = np.zeros((len(sensors), len(hz), 3), complex)
    variance = np.full((len(sensors), len(hz), 3), np.inf)
    phases, phase_deviation = np.zeros((2, count, len(hz)))
    for k, f in enumerate(hz):
        rows = [
            [_rows(s, u[k], g[k]) for s, (u, g) in zip(own, of, strict=True)]
            for own, of in zip(sensors, phasors, strict=True)
        ]
        fit = triangulated(rows, known.at(f, _apart(sensors[0])))
        found[:, k], variance[:, k], phases[:, k], phase_deviation[:, k] = fit
    out = []
    for s, own in enumerate(sensors):
        level = _floor(own)
        peaks = _peaks(hz, deviation, found[s], variance[s], level, shared[s])
        strong = ordered([p for p in peaks if (p.amplitude > level).any()])
        of_clips = [
            _of_clip(series, u, g, strong, hz) for series, (u, g) in zip(own, phasors[s], strict=True)
        ]
        out.append(Together(_spectrum(own, hz, phases, level, strong), peaks, tuple(of_clips)))
    return out, ClipPhases(tuple(s.clock for s in sensors[0]), hz, phases, phase_deviation)


def _apart(clips: Sequence[Series]) -> float:
    """Return the distance in Hz within which two frequencies are one."""
    return _SAME / float(np.median([np.ptp(s.times_s) for s in clips]))


def _frequencies(sensors: Sequence[Sequence[Series]], known: KnownPhases) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies [K] Hz and deviations: significant in two clips, or in one and in the motion stage."""
    found = []  # strength, Hz, deviation, sensor, clip
    for s, own in enumerate(sensors):
        for c, series in enumerate(own):
            spectrum = spectrum_of(series.times_s, series.displacement, series.noise, series.model_share)
            found += [
                (strength_of(p), p.frequency_hz, p.frequency_deviation_hz, s, c)
                for p in spectrum.peaks
                if p.is_above.any()
            ]
    apart = _apart(sensors[0])
    hz: list[tuple[float, float]] = []
    for _, near, *_ in sorted(found, reverse=True):
        if len(hz) == _MOST or any(abs(near - f) <= apart for f, _ in hz):
            continue
        same = [p for p in found if abs(p[1] - near) <= apart]
        if len({p[4] for p in same}) > 1 or known.at(near, apart) is not None:
            hz.append(_mean_frequency(same))
    return np.array([f for f, _ in hz]), np.array([d for _, d in hz])


def _mean_frequency(peaks: Sequence[tuple[float, float, float, int, int]]) -> tuple[float, float]:
    """Return mean and standard deviation over clips of the best sensor; the latter is at least the clips' scatter."""
    best = 0.0, np.inf
    for sensor in {p[3] for p in peaks}:
        hz, deviation = np.array([p[1:3] for p in peaks if p[3] == sensor]).T
        weights = 1 / np.maximum(deviation, 1e-12) ** 2
        mean = float(weights @ hz / weights.sum())
        scatter = float(weights @ (hz - mean) ** 2) / max(len(hz) - 1, 1)
        own = float(np.sqrt(max(scatter, 1.0) / weights.sum()))
        best = min(best, (mean, own), key=lambda pair: pair[1])
    return best


def _phasors(series: Series, hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return phasors [K, 3] of sinusoids fitted together, along the series' axes, and their variance gains [K]."""
    inverse = np.linalg.pinv(sinusoid_columns(hz, series.times_s))
    answer, gain, k = inverse @ series.displacement, (inverse**2).sum(1), len(hz)
    return answer[1 : 1 + k] + 1j * answer[1 + k :], (gain[1 : 1 + k] + gain[1 + k :]) / 2


def _noise(series: Series) -> np.ndarray:
    """Return the covariance [m, m] of a sample's noise along the observed axes."""
    some = np.flatnonzero(series.is_observed)
    root = np.sqrt(series.noise_factor[some])
    return np.asarray(series.unit_covariance[np.ix_(some, some)] * np.outer(root, root))


def _rows(series: Series, phasor: np.ndarray, gain: float) -> Rows:
    """Return the equations of a phasor [3] whose noise has `gain` times a sample's variance."""
    some = np.flatnonzero(series.is_observed)
    if not len(some):
        return Rows(np.zeros((0, 3)), np.zeros(0, complex))
    error = np.hypot(series.halves_share, series.false_share) * np.linalg.norm(phasor[series.is_resolved])
    covariance = gain * _noise(series) + np.diag(error[some] ** 2)
    root = np.linalg.cholesky(np.linalg.inv(covariance + _TINY * np.trace(covariance) * np.eye(len(some)))).T
    return Rows(root @ series.axes[some], root @ phasor[some])


def _peaks(
    hz: np.ndarray,
    hz_deviation: np.ndarray,
    phasors: np.ndarray,
    variance: np.ndarray,
    level: np.ndarray,
    shared: float,
) -> tuple[Peak, ...]:
    """Return the peaks of a sensor's phasors [K, 3] and their variances; `shared` as in `together`."""
    size = np.linalg.norm(phasors[:, is_resolved(level)], axis=1)
    rms = float(np.sqrt((size**2).sum() / 2))
    share = min(shared / rms, 1.0) if rms > 0 else 0.0
    is_seen = np.isfinite(level)
    ratio = np.where(is_seen, level, 0) / max(float(np.min(level)), 1e-300)
    out = []
    for k, f in enumerate(hz):
        error = np.sqrt(variance[k] + (share * ratio * size[k]) ** 2)
        error = np.where(is_seen & np.isfinite(variance[k]), error, np.inf)
        out.append(Peak(float(f), float(hz_deviation[k]), phasors[k], error, level))
    return tuple(out)


def _floor(clips: Sequence[Series]) -> np.ndarray:
    """Return the floor [3] of the spectrum along the world's axes; inf along directions that no clip shows."""
    information = (w @ s.axes for w, s in zip(_spectrum_weights(clips), clips, strict=True))
    values, vectors = np.linalg.eigh(sum(information, np.zeros((3, 3))))
    is_seen = values > UNSEEN * max(values[-1], 1e-300)
    hidden = (vectors[:, ~is_seen] ** 2).sum(1)
    variance = (vectors[:, is_seen] ** 2 / values[is_seen]).sum(1)
    factor = floor_factor(max(len(s.times_s) for s in clips))
    return np.where(hidden > 0.5, np.inf, factor * np.sqrt(variance))


def _spectrum_weights(clips: Sequence[Series]) -> list[np.ndarray]:
    """Return Rᵀ N⁻¹ [3, 3] for each clip, with N the covariance of the noise in its spectrum."""
    out = []
    for series in clips:
        some = np.flatnonzero(series.is_observed)
        weight = np.zeros((3, 3))
        if len(some):
            unit = float(rayleigh(series.times_s, np.ones((len(series.times_s), 3)))[0])
            noise = _noise(series) * unit**2
            noise += _TINY * np.trace(noise) * np.eye(len(some))
            weight[:, some] = series.axes[some].T @ np.linalg.inv(noise)
        out.append(weight)
    return out


def _spectrum(
    clips: Sequence[Series], hz: np.ndarray, phases: np.ndarray, level: np.ndarray, peaks: Sequence[Peak]
) -> Spectrum:
    """Return the spectrum of all clips, turned at every frequency by the phases of the nearest one found."""
    longest = max(clips, key=lambda s: len(s.times_s))
    grid = frequency_grid(longest.times_s)
    weights = _spectrum_weights(clips)
    inverse = np.linalg.pinv(sum((w @ s.axes for w, s in zip(weights, clips, strict=True)), np.zeros((3, 3))))
    nearest = np.abs(grid[:, None] - hz).argmin(1) if len(hz) else np.zeros(len(grid), int)
    total = np.zeros((len(grid), 3), complex)
    for c, (series, weight) in enumerate(zip(clips, weights, strict=True)):
        turn = np.zeros(len(grid))
        if len(hz):
            middle = (series.times_s[0] + series.times_s[-1]) / 2
            turn = 2 * np.pi * (grid - hz[nearest]) * middle - phases[c, nearest]
        own = transformed(grid, series.times_s, series.displacement)
        total += np.exp(1j * turn)[:, None] * (own @ weight.T)
    floor = np.broadcast_to(level, (len(grid), 3))
    return Spectrum(grid, np.abs(total @ inverse), floor, with_harmonics(peaks, longest.times_s))


def _of_clip(
    series: Series, phasors: np.ndarray, gain: np.ndarray, peaks: Sequence[Peak], hz: np.ndarray
) -> tuple[Peak, ...]:
    """Return a clip's phasors at the frequencies of the peaks."""
    floor = rayleigh(series.times_s, series.noise) * floor_factor(len(series.times_s))
    level = np.where(series.is_observed, floor, np.inf)
    out = []
    for peak in peaks:
        k = int(np.abs(hz - peak.frequency_hz).argmin())
        error = series.model_share * np.linalg.norm(phasors[k][series.is_resolved])
        deviation = np.hypot(np.sqrt(gain[k]) * series.noise[0], error)
        out.append(Peak(peak.frequency_hz, peak.frequency_deviation_hz, phasors[k], deviation, level))
    return tuple(out)
