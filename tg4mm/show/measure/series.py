"""Displacement, velocity and acceleration of a sensor over time, with a standard deviation for each sample.

u_f = A⁻¹ b_f from the sum of two halves of the data with separate equations (`rigid.py`). Independent pixel noise would
give the covariance A⁻¹ times a factor. The noise of real pixels is correlated (codecs, demosaicing, errors of the
model), so that factor is estimated from the result, for each axis: the difference of the halves' answers over time,
relative to that at unit noise, or the level that most of the answer's spectrum stays above, whichever is larger.

Errors of the model are common to both halves and grow with the motion. The run states the uncertainty of every
Gaussian's motion (docs/method.md, "Uncertainty"). A sensor averages over its region and fits only a rigid motion, which
leaves half of that along each axis: a number from a generated set with exact truth (docs/measure.md). The halves'
difference in proportion to the motion is added. An error of the model spreads over directions as noise would. Which
part is static before a moving camera is one unknown of the complete region: that error is not halved, and where the run
does not know it, it is as large as the motion.

For velocity and acceleration lines are differentiated exactly, the residual by finite differences. Differences alone
would lose much of a fast vibration, 17 % of the velocity at six samples a period. A sample's noise n and a line's error
δ give the error D n + (d/dt − D) δ with the differences D; errors proportional to the motion are proportional to its
derivative, too. The deviations do not cover motion outside of lines above a quarter of the rate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal.windows import blackmanharris

from tg4mm.show.measure.rigid import Equations, RigidBody
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.spectrum import Peak

_QUARTILE = float(-np.log(0.75))  # of a spectrum of noise, in units of its mean power
_FEWEST = 12  # samples of a spectrum that gives a noise level
UNRESOLVED = 10.0  # times the deviation of the best direction: a direction beyond it is not resolved
_SURE = 1.5  # times as uncertain as without rotations a translation may become
_TURNS = 10.0  # times the deviation of a translation: a rotation times the radius beyond it is not resolved
UNSEEN = 1e-6  # of the best direction's information: less is rounding, and is not observed
OF_UNCERTAINTY = 0.5
_MOST = 1.0  # of the motion


@dataclass(frozen=True)
class Series:
    """Displacement of one sensor on one clock, about its mean over the record."""

    clock: str  # "" where all cameras share one
    times_s: np.ndarray  # [T] seconds
    displacement: np.ndarray  # [T, A] scene units, along `axes`
    noise: np.ndarray  # [T, A] standard deviation of the noise; inf along a direction that is not observed
    deviation: np.ndarray  # [T, A] standard deviation with errors of the model
    axes: np.ndarray  # [A, 3], rows: unit vectors in the world; two of a flat capture, else three
    labels: tuple[str, ...]  # [A] of the axes
    rotation: np.ndarray | None  # [T, B] radians about the axes through the centre; None if not resolved
    rotation_deviation: np.ndarray | None  # [T, B]
    unit_covariance: np.ndarray  # [A, A] A⁻¹ B A⁻ᵀ, mean over time: covariance at unit pixel noise
    noise_factor: np.ndarray  # [A] variance over unit_variance, one for independent noise of known pixels
    model_share: np.ndarray  # [A] standard deviation of the model's errors over the motion's length
    halves_share: np.ndarray  # [A] the part of it by which the two halves of the data differ
    false_share: np.ndarray  # [A] part of a motion of unit length that errors of the scene at rest hide

    @property
    def unit_variance(self) -> np.ndarray:
        """Return [A]; inf along axes that are not observed."""
        return np.diag(self.unit_covariance)

    @property
    def correlation(self) -> np.ndarray:
        """Return [A, A] of the axes' errors; none for an axis that is not observed."""
        root = np.sqrt(np.where(np.isfinite(self.unit_variance), self.unit_variance, 0))
        scale = np.outer(root, root)
        found = np.divide(self.unit_covariance, scale, out=np.zeros_like(scale), where=scale > 0)
        np.fill_diagonal(found, 1)
        return found

    @property
    def is_observed(self) -> np.ndarray:
        """Return [A] bool, for each axis."""
        return np.asarray(np.isfinite(self.noise).all(0))

    @property
    def is_resolved(self) -> np.ndarray:
        """Return [A] bool: observed, and at most ten times as uncertain as the best direction."""
        variance = np.where(self.is_observed, self.unit_variance, np.inf)
        return np.asarray(variance <= UNRESOLVED**2 * variance.min()) & self.is_observed

    def world(self) -> np.ndarray:
        """Return the displacement [T, 3] along the world's x, y, z; 0 along axes that are not observed."""
        return np.asarray(self.displacement @ self.axes)


def series_of(
    equations: Equations,
    times_s: np.ndarray,
    axes: np.ndarray,
    labels: tuple[str, ...],
    radius: float,
    clock: str = "",
    slow: np.ndarray | None = None,
) -> Series:
    """Solve for one body on one clock. `slow` [S, F]: functions of time to remove (for a moving camera)."""
    shifts = slice(len(axes))
    dof = equations.false.shape[-1] if _resolves_rotation(equations, len(axes)) else len(axes)
    false = _false_share(equations, dof, len(axes))
    normals, noise, right_hand_sides = equations.normals, equations.noise, equations.right_hand_sides
    answers = [_solved(normals[h], noise[h], right_hand_sides[h], dof) for h in (0, 1)]
    whole, covariance = _solved(normals.sum(0), noise.sum(0), right_hand_sides.sum(0), dof)
    out = _without(whole, slow)
    difference = _without(answers[0][0] - answers[1][0], slow)
    # The part proportional to the motion is an error of the model in each half, not noise: it must not lift the floor.
    along = np.linalg.lstsq(out[:, shifts], difference, rcond=None)[0]
    of_motion = out[:, shifts] @ along
    difference = difference - of_motion
    size = float(np.sqrt((out[:, shifts] ** 2).sum(1).mean()))
    share = np.sqrt((of_motion[:, shifts] ** 2).mean(0)) / 2 / max(size, 1e-300)
    free = len(out) / max(len(out) - 4 - (0 if slow is None else len(slow) - 1), 1)
    # The halves' errors are independent: the difference's variance is the sum of theirs.
    diagonals = (np.diagonal(c, axis1=1, axis2=2) for c in (covariance, answers[0][1], answers[1][1]))
    variance, first, second = diagonals
    expected = first + second
    factor = _ratio(difference**2, expected) * free
    factor = np.maximum(factor, _floor_factor(out, variance))
    with np.errstate(invalid="ignore"):  # 0 times the infinite variance of what is not observed
        deviation = np.sqrt(factor * variance)
    deviation[np.isnan(deviation)] = np.inf
    out = np.where(np.isfinite(deviation), out, 0.0)
    turned, turns, turn_deviation = slice(len(axes), None), None, None
    if dof > len(axes):
        turns, turn_deviation = out[:, turned] / radius, deviation[:, turned] / radius
    return Series(
        clock, times_s, out[:, shifts], deviation[:, shifts], deviation[:, shifts], axes, labels, turns, turn_deviation,
        covariance[:, shifts, shifts].mean(0), factor[shifts], share, share, false,
    )  # fmt: skip


def _solved(
    normals: np.ndarray, noise: np.ndarray, right_hand_sides: np.ndarray, dof: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return answers A⁻¹ b [F, dof] and covariances at unit noise A⁻¹ B A⁻ᵀ [F, dof, dof] for the first unknowns.

    normals A, noise B [F or 1, K, K], sides b [F, K]. A is inverted on the directions that B shows to be observed; the
    variance of the others is inf.
    """
    answers, covariances = [], []
    for a, b in zip(normals[:, :dof, :dof], noise[:, :dof, :dof], strict=True):
        values, vectors = np.linalg.eigh(b)
        is_seen = values > UNSEEN * max(values[-1], 1e-30)
        seen = vectors[:, is_seen]
        inverse = seen @ np.linalg.pinv(seen.T @ a @ seen, rcond=UNSEEN) @ seen.T
        hidden = (vectors[:, ~is_seen] ** 2).sum(1)
        answers.append(inverse)
        covariance = inverse @ b @ inverse.T
        covariance[np.diag_indices(dof)] = np.where(hidden > 0.5, np.inf, np.diag(covariance))
        covariances.append(covariance)
    shape = len(right_hand_sides), dof, dof
    answer = np.einsum("fij,fj->fi", np.broadcast_to(answers, shape), right_hand_sides[:, :dof])
    return answer, np.broadcast_to(covariances, shape).copy()


def _false_share(equations: Equations, dof: int, shifts: int) -> np.ndarray:
    """Return the root sum of squares of the rows of A⁻¹ F [A], at most 1.

    By how much the answer along an axis misses a motion of unit length in any direction.
    """
    a = equations.normals.sum(0).mean(0)[:dof, :dof]
    share = (np.linalg.pinv(a, rcond=UNSEEN) @ equations.false.sum(0)[:dof, :shifts])[:shifts]
    return np.minimum(np.sqrt((share**2).sum(1)), 1.0)


def _resolves_rotation(equations: Equations, shifts: int) -> bool:
    """Return whether rotations are resolved and translations stay about as certain as without them: a large region."""
    a = equations.noise.sum(0).mean(0)
    if np.linalg.eigvalsh(a)[0] <= 1e-9 * np.trace(a):
        return False
    with_turns, alone = np.diag(np.linalg.inv(a)), np.diag(np.linalg.pinv(a[:shifts, :shifts]))
    halves = all(np.linalg.eigvalsh(n.mean(0))[0] > 1e-9 * np.trace(a) for n in equations.noise)
    is_sure = bool((with_turns[:shifts] <= _SURE**2 * alone).all())
    return halves and is_sure and bool(with_turns[shifts:].max() <= _TURNS**2 * with_turns[:shifts].max())


def _without(answer: np.ndarray, slow: np.ndarray | None) -> np.ndarray:
    """Subtract the mean over time, or the part that the slow functions explain."""
    if slow is None:
        return answer - answer.mean(0)
    return np.asarray(answer - slow.T @ np.linalg.lstsq(slow.T, answer, rcond=None)[0])


def _ratio(squares: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the mean over time of squares over their expectation [K]; 1 where nothing is expected."""
    good = np.isfinite(expected) & (expected > 0)
    shares = np.where(good, squares / np.where(good, expected, 1), np.nan)
    return np.where(good.any(0), np.nanmean(np.where(good, shares, 0), 0), 1.0)


def _floor_factor(answer: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Estimate from the lower quartile of the answer's spectrum [K]: noise fills it, vibration a few of its bins."""
    if len(answer) < _FEWEST:
        return np.zeros(answer.shape[1])
    scaled = answer / np.sqrt(np.where(np.isfinite(variance) & (variance > 0), variance, np.inf))
    window = blackmanharris(len(answer), sym=False)[:, None]  # whose side lobes no strong sinusoid fills
    power = np.abs(np.fft.rfft((scaled - scaled.mean(0)) * window, axis=0))[2:-1] ** 2
    return np.asarray(np.quantile(power, 0.25, axis=0) / _QUARTILE / (window**2).sum())


def with_model_error(series: Series, body: RigidBody, scene: Prepared) -> Series:
    """Add the error of the model to `model_share` and `deviation`: σ_f² = noise² + (share · |u_f|)²."""
    size = np.linalg.norm(np.where(series.is_resolved, series.displacement, 0), axis=1)
    rms = float(np.sqrt((size**2).mean()))
    base = min(shared_error(scene, body) / rms, _MOST) if rms > 0 else 0.0
    base = _MOST if scene.fit.undetermined_hz else base
    least = np.min(series.unit_variance[series.is_observed], initial=np.inf)
    ratio = np.sqrt(np.where(series.is_observed, series.unit_variance, 0) / least)
    share = np.minimum(np.hypot(base * ratio, series.model_share), np.maximum(ratio, 1))
    share = np.hypot(share, np.where(series.is_observed, series.false_share, 0))
    deviation = np.sqrt(series.noise**2 + (share * size[:, None]) ** 2)
    return replace(series, model_share=share, deviation=deviation)


def shared_error(scene: Prepared, body: RigidBody) -> float:
    """Return the run's uncertainty of the region's Gaussians along one axis, scene units rms; 0 if it has none."""
    found = scene.fit.uncertainty
    if not found:
        return 0.0
    ground = found.get("ground", np.zeros(1))
    if (along := found.get("across_sight")) is None:  # which one camera's run has
        along = np.sqrt(np.maximum(found["displacement"] ** 2 - ground**2, 0) / 3)
    seen = body.weights * scene.seen

    def rms(values: np.ndarray) -> float:
        return float(
            np.sqrt((seen @ np.broadcast_to(values.astype(np.float64) ** 2, seen.shape)) / seen.sum())
        )

    return float(np.hypot(OF_UNCERTAINTY * rms(along), rms(ground)))


@dataclass(frozen=True)
class Derivatives:
    """The derivatives of a displacement [T, A]."""

    velocity: np.ndarray  # [T, A] scene units / s
    acceleration: np.ndarray  # [T, A] scene units / s²


def derivatives_of(times_s: np.ndarray, values: np.ndarray, peaks: Sequence[Peak]) -> Derivatives:
    """Differentiate values [T, A] at times [T] with known `peaks`."""
    velocity, acceleration, left = np.zeros_like(values), np.zeros_like(values), values.copy()
    for peak in peaks:
        omega = 2j * np.pi * peak.frequency_hz - (0.0 if peak.line is None else peak.line.decay_per_s)
        phasor = np.where(np.isfinite(peak.deviation), peak.phasor, 0)
        turning = peak.envelope(times_s) * np.exp(2j * np.pi * peak.frequency_hz * times_s)
        left -= (turning[:, None] * phasor).real
        velocity += (omega * turning[:, None] * phasor).real
        acceleration += (omega**2 * turning[:, None] * phasor).real
    velocity += np.gradient(left, times_s, axis=0)
    acceleration += _second_difference(left, times_s)
    return Derivatives(velocity, acceleration)


def deviations_of(
    found: Derivatives, times_s: np.ndarray, noise: np.ndarray, share: np.ndarray, peaks: Sequence[Peak]
) -> Derivatives:
    """Return standard deviations of `found` for samples with noise [T, A] and errors of a `share` [A] of the motion."""
    step = float(np.median(np.diff(times_s)))
    variances = [_difference_variance(noise**2, times_s), _second_variance(noise**2, times_s)]
    for peak in peaks:
        omega, size = 2 * np.pi * peak.frequency_hz, peak.envelope(times_s)[:, None] * peak.deviation
        missed = omega - np.sin(omega * step) / step, omega**2 - (2 * np.sin(omega * step / 2) / step) ** 2
        for order in (0, 1):
            variances[order] = variances[order] + (missed[order] * size) ** 2
    out = []
    for variance, values in zip(variances, (found.velocity, found.acceleration), strict=True):
        length = np.linalg.norm(np.where(np.isfinite(variance), values, 0), axis=1)
        out.append(np.sqrt(variance + (share * length[:, None]) ** 2))
    return Derivatives(*out)


def _difference_variance(variance: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Return the variance [T, A] of `np.gradient` of independent samples."""
    out = np.empty_like(variance)
    before, after = np.diff(times_s)[:-1, None], np.diff(times_s)[1:, None]
    total, old, mid, new = before + after, variance[:-2], variance[1:-1], variance[2:]
    out[1:-1] = (before / (after * total)) ** 2 * new + (after / (before * total)) ** 2 * old
    out[1:-1] += np.where(before == after, 0.0, ((after - before) / (before * after)) ** 2 * mid)
    out[0] = (variance[0] + variance[1]) / (times_s[1] - times_s[0]) ** 2
    out[-1] = (variance[-1] + variance[-2]) / (times_s[-1] - times_s[-2]) ** 2
    return out


def _second_variance(variance: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    out = np.full_like(variance, np.inf)
    if len(variance) < 3:
        return out
    before, after = np.diff(times_s)[:-1, None], np.diff(times_s)[1:, None]
    total = before + after
    out[1:-1] = 4 * (
        variance[2:] / (after * total) ** 2
        + variance[1:-1] / (before * after) ** 2
        + variance[:-2] / (before * total) ** 2
    )
    out[0], out[-1] = out[1], out[-2]
    return out


def _second_difference(values: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    out = np.zeros_like(values)
    if len(values) < 3:
        return out
    before, after = np.diff(times_s)[:-1, None], np.diff(times_s)[1:, None]
    out[1:-1] = (
        2 * ((values[2:] - values[1:-1]) / after - (values[1:-1] - values[:-2]) / before) / (before + after)
    )
    out[0], out[-1] = out[1], out[-2]
    return out
