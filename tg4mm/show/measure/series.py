"""Displacement of a sensor over time, with a standard deviation for each sample.

u_f = A⁻¹ b_f from the sum of two halves of the data, whose equations stand apart (`rigid.py`). Pixel noise alone would
give the covariance A⁻¹ times a number; the noise of real pixels hangs together (codecs, demosaicing, errors of the
model), so that number is found from the result, for each axis: what the halves' answers differ by in time, over what
they would at unit noise; and where that is larger, the level that most of the answer's spectrum does not fall below.

Errors of the model are common to both halves and grow with the motion. The run knows of every Gaussian how uncertain
its motion is (docs/method.md, "Uncertainty"). A sensor averages over its region and fits nothing but a rigid motion, so
half of that is left along each axis: a number from a generated set with exact truth (docs/measure.md). To it is added
what the halves differ by in proportion to the motion. An error of the model spreads over directions as noise would.
Which part stands still before a moving camera is one question for the whole region: that error stays whole, and where
the run does not know it, is as large as the motion.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal.windows import blackmanharris

from tg4mm.show.measure.rigid import Body, Equations
from tg4mm.show.measure.scene import Prepared

_QUARTILE = float(-np.log(0.75))  # of a spectrum of noise, in units of its mean power
_FEWEST = 12  # samples that a spectrum is judged by
TOLD = 10.0  # times as uncertain as the best direction: beyond it a direction is not told
_SURE = 1.5  # times as uncertain as without rotations a translation may become
_TURNS = 10.0  # times as uncertain as a translation: a rotation times the radius beyond it is not told
UNSEEN = 1e-6  # of the best-seen direction's information: less is rounding, and is not observed
OF_UNCERTAINTY = 0.5
_MOST = 1.0  # of the motion


@dataclass(frozen=True)
class Series:
    """One sensor on one clock, about its mean over the record."""

    clock: str  # "" where all cameras share one
    times_s: np.ndarray  # [T] seconds
    displacement: np.ndarray  # [T, A] scene units, along `axes`
    noise: np.ndarray  # [T, A] standard deviation of the noise; inf along a direction that is not observed
    deviation: np.ndarray  # [T, A] standard deviation with errors of the model
    axes: np.ndarray  # [A, 3], rows: unit vectors in the world; two of a flat capture, else three
    labels: tuple[str, ...]  # [A] of the axes
    rotation: (
        np.ndarray | None
    )  # [T, B] radians about the axes through the centre; None where it cannot be told
    rotation_deviation: np.ndarray | None  # [T, B]
    unit_covariance: np.ndarray  # [A, A] A⁻¹ B A⁻ᵀ, mean over time: how well the pictures tell each direction
    noise_factor: np.ndarray  # [A] variance over unit_variance, one for independent noise of known pixels
    model_share: np.ndarray  # [A] standard deviation of the model's errors over the motion's length
    halves_share: np.ndarray  # [A] the part of it that the two halves of the data differ by
    false_share: np.ndarray  # [A] what the scene at rest, where it is wrong, hides of a motion of unit length

    @property
    def unit_variance(self) -> np.ndarray:
        """[A]; inf along what is not seen."""
        return np.diag(self.unit_covariance)

    @property
    def correlation(self) -> np.ndarray:
        """[A, A] of the axes' errors; of an axis that is not seen, none."""
        root = np.sqrt(np.where(np.isfinite(self.unit_variance), self.unit_variance, 0))
        scale = np.outer(root, root)
        found = np.divide(self.unit_covariance, scale, out=np.zeros_like(scale), where=scale > 0)
        np.fill_diagonal(found, 1)
        return found

    @property
    def is_observed(self) -> np.ndarray:
        """[A] bool, of the axes."""
        return np.asarray(np.isfinite(self.noise).all(0))

    @property
    def is_resolved(self) -> np.ndarray:
        """[A] bool: observed, and not ten times less sure than the best direction, as one camera's sight is."""
        variance = np.where(self.is_observed, self.unit_variance, np.inf)
        return np.asarray(variance <= TOLD**2 * variance.min()) & self.is_observed

    def world(self) -> np.ndarray:
        """[T, 3] displacement along the world's x, y, z; what is not observed counts as 0."""
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
    """The answer of one body on one clock. `slow` [S, F]: functions of time to take out of it (a moving camera's)."""
    shifts = slice(len(axes))
    dof = equations.false.shape[-1] if _tells_rotation(equations, len(axes)) else len(axes)
    false = _false_share(equations, dof, len(axes))
    normals, noise, sides = equations.normals, equations.noise, equations.sides
    answers = [_solved(normals[h], noise[h], sides[h], dof) for h in (0, 1)]
    whole, covariance = _solved(normals.sum(0), noise.sum(0), sides.sum(0), dof)
    out = _without(whole, slow)
    difference = _without(answers[0][0] - answers[1][0], slow)
    # What goes with the motion is an error of the model in each half, not noise: it must not lift the floor.
    along = np.linalg.lstsq(out[:, shifts], difference, rcond=None)[0]
    of_motion = out[:, shifts] @ along
    difference = difference - of_motion
    size = float(np.sqrt((out[:, shifts] ** 2).sum(1).mean()))
    share = np.sqrt((of_motion[:, shifts] ** 2).mean(0)) / 2 / max(size, 1e-300)
    free = len(out) / max(len(out) - 4 - (0 if slow is None else len(slow) - 1), 1)
    # Two halves with errors e₁, e₂ of their own: the difference's variance is the sum of theirs.
    variance, expected = _diagonal(covariance), _diagonal(answers[0][1]) + _diagonal(answers[1][1])
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
    normals: np.ndarray, noise: np.ndarray, sides: np.ndarray, dof: int
) -> tuple[np.ndarray, np.ndarray]:
    """[F, dof] answers A⁻¹ b and [F, dof, dof] covariances at unit noise A⁻¹ B A⁻ᵀ, of the first unknowns.

    normals A, noise B [F or 1, K, K], sides b [F, K]. What is seen is told by B, and A is inverted on that; the
    variance of what is not seen is inf.
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
    shape = len(sides), dof, dof
    answer = np.einsum("fij,fj->fi", np.broadcast_to(answers, shape), sides[:, :dof])
    return answer, np.broadcast_to(covariances, shape).copy()


def _diagonal(matrices: np.ndarray) -> np.ndarray:
    """[F, K] of [F, K, K]."""
    return np.diagonal(matrices, axis1=1, axis2=2).copy()


def _false_share(equations: Equations, dof: int, shifts: int) -> np.ndarray:
    """[A]: root of the sum of squares of A⁻¹ F by rows, over true motions across what is seen; at most 1.

    By how much the answer along an axis misses a motion of unit length in a direction that is told or hidden alike.
    """
    a = equations.normals.sum(0).mean(0)[:dof, :dof]
    share = (np.linalg.pinv(a, rcond=UNSEEN) @ equations.false.sum(0)[:dof, :shifts])[:shifts]
    return np.minimum(np.sqrt((share**2).sum(1)), 1.0)


def _tells_rotation(equations: Equations, shifts: int) -> bool:
    """Whether the region is large enough: translations stay as sure as without rotations, and these are told."""
    a = equations.noise.sum(0).mean(0)
    if np.linalg.eigvalsh(a)[0] <= 1e-9 * np.trace(a):
        return False
    with_turns, alone = np.diag(np.linalg.inv(a)), np.diag(np.linalg.pinv(a[:shifts, :shifts]))
    halves = all(np.linalg.eigvalsh(n.mean(0))[0] > 1e-9 * np.trace(a) for n in equations.noise)
    is_sure = bool((with_turns[:shifts] <= _SURE**2 * alone).all())
    return halves and is_sure and bool(with_turns[shifts:].max() <= _TURNS**2 * with_turns[:shifts].max())


def _without(answer: np.ndarray, slow: np.ndarray | None) -> np.ndarray:
    """Less the mean over time, or what the slow functions explain."""
    if slow is None:
        return answer - answer.mean(0)
    return np.asarray(answer - slow.T @ np.linalg.lstsq(slow.T, answer, rcond=None)[0])


def _ratio(squares: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """[K] mean over time of squares over what is expected; 1 where nothing is."""
    good = np.isfinite(expected) & (expected > 0)
    shares = np.where(good, squares / np.where(good, expected, 1), np.nan)
    return np.where(good.any(0), np.nanmean(np.where(good, shares, 0), 0), 1.0)


def _floor_factor(answer: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """[K] by the lower quartile of the answer's own spectrum: noise fills it, vibration is in a few of its bins."""
    if len(answer) < _FEWEST:
        return np.zeros(answer.shape[1])
    scaled = answer / np.sqrt(np.where(np.isfinite(variance) & (variance > 0), variance, np.inf))
    window = blackmanharris(len(answer), sym=False)[:, None]  # whose side lobes no strong sinusoid fills
    power = np.abs(np.fft.rfft((scaled - scaled.mean(0)) * window, axis=0))[2:-1] ** 2
    return np.asarray(np.quantile(power, 0.25, axis=0) / _QUARTILE / (window**2).sum())


def with_model_error(series: Series, body: Body, scene: Prepared) -> Series:
    """The series with `model_share` and with it in `deviation`: σ_f² = noise² + (share · |u_f|)²."""
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


def shared_error(scene: Prepared, body: Body) -> float:
    """Scene units rms, along one axis: by the run's uncertainty of the region's Gaussians; 0 where it has none."""
    known = _along_an_axis(scene)
    if known is None:
        return 0.0
    ground = scene.fit.uncertainty.get("ground", np.zeros(1))
    return float(np.hypot(OF_UNCERTAINTY * _rms(scene, body, known), _rms(scene, body, ground)))


def _rms(scene: Prepared, body: Body, values: np.ndarray) -> float:
    """Over what is seen of a region, of values [N]."""
    seen = body.weights * scene.seen
    return float(np.sqrt((seen @ np.broadcast_to(values.astype(np.float64) ** 2, seen.shape)) / seen.sum()))


def _along_an_axis(scene: Prepared) -> np.ndarray | None:
    """[N] standard deviation of every Gaussian along one axis, scene units: of one camera across its sight."""
    found = scene.fit.uncertainty
    if "across_sight" in found:
        return found["across_sight"]
    if not found:
        return None
    of_model = found["displacement"] ** 2 - found.get("ground", np.zeros(1)) ** 2
    return np.asarray(np.sqrt(np.maximum(of_model, 0) / 3))
