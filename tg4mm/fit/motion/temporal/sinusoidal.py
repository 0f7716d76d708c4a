"""Vibration as a few sinusoids, for cameras with independent clocks and for a moving camera.

Every frequency has two fields, of its cosine and its sine. Frequencies are found first, from the shifts of regions of
Gaussians in the pictures. A region's shift along the picture's rows and columns in one frame is the least-squares
solution of that frame's change through the Jacobian, nuisance projected out: b = Eᵀ Jᵀ Δ summed over the region,
A = Eᵀ Jᵀ J E, shift = A⁻¹ b with E the camera's right and down axes. Nothing is smoothed over space or time, so its
noise is that of the pictures.

Least-squares spectra (Lomb 1976, Scargle 1982) of every region's shift, each in units of its noise, are averaged over
regions and clocks. A peak that stands out of the other frequencies is a frequency; its sinusoids are fitted to all
series and subtracted, and the residual is searched for the next. All frequencies are then refined together.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from scipy.optimize import least_squares

from tg4mm.core.lines.band import FEWEST, BandLine, tone_in
from tg4mm.core.lines.model import log_floor
from tg4mm.core.progress import progress
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step, concatenated
from tg4mm.fit.motion.config import MotionConfig, asked_band
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import pixels_moved
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.nuisance.fixed_cameras import FixedCameras
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import Observations, PosedFrames, whole_pictures
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.spectrum import constant_and_trend, polynomials, residual, sinusoids
from tg4mm.fit.motion.split_half import reliability
from tg4mm.fit.motion.targets import TargetImages
from tg4mm.fit.motion.temporal import TemporalModel

MOST = 6
_OVERSAMPLED = 6  # frequencies tried per 1 / duration
_CAP = 300.0  # of a series' power over its noise: a few that move much do not hide the rest
_STANDS_OUT = 5.0  # robust deviations of the noise's logarithm above it
LEAST = 1.3  # times the noise: weaker peaks are noise, however smooth its spectrum is
_LOUD = 10.0  # times the noise: such a peak has side lobes all over a short record, and is taken out to see the noise
_WEAK = 0.03  # of the strongest peak's power above the floor: weaker is taken for leakage
_THIRDS = 3
_STRONG = 64  # series of one clock with the most power: they decide where frequencies are refined to
_LEAST_CLOCKS = 3  # from which on their differences are estimated
_APART = 1.5  # over the duration, Hz: nearer ones are one whose amplitude changes, as a camera moves around
_PROBES = 4
_STRONGEST = 32  # series that the tone in a band is taken from
_SEEN = 0.02  # of the median region's determinant: below it a region is not seen
_HIGHEST = 0.98  # of half the frame rate


@dataclass(frozen=True)
class Frequencies:
    """Frequencies by falling strength."""

    hz: np.ndarray  # [K]
    deviation_hz: np.ndarray  # [K] standard deviation by noise (Cramér-Rao)

    def selected(self, keep: np.ndarray) -> "Frequencies":
        """Return some of the frequencies, [K] bool."""
        return Frequencies(self.hz[keep], self.deviation_hz[keep])


@dataclass(frozen=True)
class _Record:
    """Return the series of one clock, without motion below the lowest frequency."""

    y: np.ndarray  # [F, S]
    times_s: np.ndarray  # [F]
    noise: np.ndarray  # [S] variance of each series' noise

    @staticmethod
    def of(y: np.ndarray, times_s: np.ndarray, lowest_hz: float, grid: np.ndarray) -> "_Record":
        """The noise by the median over frequencies (of an exponential distribution)."""
        y = residual(y, polynomials(times_s, max(int(2 * lowest_hz * np.ptp(times_s) / 2), 1)))
        return _Record(y, times_s, np.median(_power(y, times_s, grid), axis=0) / np.log(2))

    def without(self, hz: np.ndarray) -> np.ndarray:
        """Return [F, S]: the residual of sinusoids of these frequencies [K]."""
        return residual(self.y, sinusoids(self.times_s, hz).T) if len(hz) else self.y

    def strongest(self) -> "_Record":
        """The series with the most power, each over its own noise."""
        measured = self.noise > 0
        y = self.y[:, measured] / np.sqrt(self.noise[measured])
        return replace(self, y=y[:, np.argsort((y**2).sum(0))[::-1][:_STRONG]])

    def without_third(self, k: int) -> "_Record":
        """Return all but the k-th third of the frames."""
        kept = np.delete(np.arange(len(self.y)), np.array_split(np.arange(len(self.y)), _THIRDS)[k])
        return replace(self, y=self.y[kept], times_s=self.times_s[kept])


def find_frequencies(
    series: Sequence[np.ndarray],
    times: Sequence[np.ndarray],
    lowest_hz: float,
    highest_hz: float,
    least: float = LEAST,
) -> Frequencies:
    """The frequencies in series [F_c, S_c] of each clock at times [F_c] in seconds, between two frequencies.

    A peak counts from `least` times the noise's power.
    """
    duration = max(float(np.ptp(t)) for t in times)
    grid = np.arange(lowest_hz, highest_hz, 1 / (_OVERSAMPLED * duration))
    records = [_Record.of(y, t, lowest_hz, grid) for y, t in zip(series, times, strict=True)]
    hz, strongest = np.zeros(0), 0.0
    spectrum = _spectrum(records, hz, grid)
    while len(hz) < MOST:
        allowed = (np.abs(grid[:, None] - hz) >= _APART / duration).all(1)
        if not allowed.any():
            break
        peak = int(np.where(allowed, spectrum, -1).argmax())
        more = _refined(records, np.append(hz, grid[peak]), 1 / duration)
        if more.min() < lowest_hz:  # the flank of something slower than these records resolve
            break
        after, others = _spectrum(records, more, grid), allowed
        if spectrum[peak] > _LOUD:
            others = allowed & (np.abs(grid - grid[peak]) > _APART / duration)
        if not others.any():
            break
        floor, spread = log_floor(after if spectrum[peak] > _LOUD else spectrum, grid, others)
        above = float(np.log(max(spectrum[peak], 1e-12)) - floor[peak])
        power = float(spectrum[peak] - np.exp(floor[peak]))
        strongest = max(strongest, power)
        if above < max(_STANDS_OUT * spread, np.log(least)) or power < _WEAK * strongest:
            break
        if len(more) > 1 and np.diff(np.sort(more)).min() < 0.5 * _APART / duration:
            break
        hz, spectrum = more, after
    return Frequencies(hz, np.hypot(_cramer_rao(records, hz), _scatter(records, hz, 1 / duration)))


def _power(y: np.ndarray, t: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Return [M, S]: power of each series at each frequency; mean 1 for white noise of variance 1."""
    products = (sinusoids(t, grid) @ y).reshape(len(grid), 2, -1)
    return np.asarray((products**2).sum(1) / len(t))


def _spectrum(records: Sequence[_Record], hz: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Return [M]: power over noise, mean over all series, without sinusoids of frequencies [K]; 1 for noise alone."""
    total, count = np.zeros(len(grid)), 0
    for r in records:
        measured = r.noise > 0
        total += np.minimum(
            _power(r.without(hz)[:, measured], r.times_s, grid) / r.noise[measured], _CAP
        ).sum(1)
        count += int(measured.sum())
    return total / max(count, 1)


def _refined(records: Sequence[_Record], hz: np.ndarray, step: float) -> np.ndarray:
    """Return all frequencies, moved by at most `step` to the least residual."""
    strongest = [r.strongest() for r in records]
    scale = np.sqrt(sum(float((r.y**2).sum()) for r in strongest)) or 1.0

    def misfit(f: np.ndarray) -> np.ndarray:
        return np.concatenate([r.without(f).ravel() for r in strongest]) / scale

    ends = hz - step, hz + step
    return np.asarray(least_squares(misfit, hz, bounds=ends, xtol=1e-9, ftol=1e-10, max_nfev=30).x)


def _scatter(records: Sequence[_Record], hz: np.ndarray, step: float) -> np.ndarray:
    """Return the frequencies' standard errors [K] by their scatter between clocks and between thirds of the record.

    The larger of the two. What all clips have alike (a codec that follows the motion late after a clip's first picture,
    a vibration that changes) shows in thirds of the record alone.
    """
    if not len(hz):
        return np.zeros(0)

    def deviation(groups: Sequence[Sequence[_Record]]) -> np.ndarray:
        each = [_refined(group, hz, step / 2) for group in groups]
        return np.asarray(np.std(np.array(each), axis=0, ddof=1) / np.sqrt(len(groups)))

    thirds = [[r.without_third(k) for r in records] for k in range(_THIRDS)]
    within = np.asarray((_THIRDS - 1) * deviation(thirds))  # the jackknife's
    if len(records) < _LEAST_CLOCKS:
        return within
    return np.maximum(within, deviation([[r] for r in records]))


def _cramer_rao(records: Sequence[_Record], hz: np.ndarray) -> np.ndarray:
    """Bound of each frequency's deviation: σ_f² = 3 / (π² D² Σ SNR), D the duration, Σ over series of a² F / 2σ²."""
    out = []
    for f in hz:
        information = 0.0
        for r in records:
            measured = r.noise > 0
            x = sinusoids(r.times_s, np.array([f])).T
            amplitude2 = (np.linalg.lstsq(x, r.y[:, measured], rcond=None)[0] ** 2).sum(0)
            snr = len(x) * amplitude2 / (2 * r.noise[measured])
            information += float(np.maximum(snr - 1, 0).sum()) * float(np.ptp(r.times_s)) ** 2
        out.append(np.sqrt(3 / (np.pi**2 * max(information, 1e-12))))
    return np.array(out)


@dataclass(frozen=True)
class RegionSeries:
    """Shifts of G regions in the F frames of one clock; a moving camera has axes and normal matrices per frame."""

    times_s: np.ndarray  # [F]
    sides: np.ndarray  # [F, G, 2] b, scene units⁻¹
    normals: np.ndarray  # [F or 1, G, 2, 2] A
    axes: np.ndarray  # [F or 1, 2, 3] right and down, unit vectors in the world

    def arrays(self) -> Arrays:
        """Return the arrays of a checkpoint: all but the times."""
        return {"sides": self.sides, "normals": self.normals, "axes": self.axes}

    def whitened(self) -> np.ndarray:
        """Return A^(-1/2) b, [F, 2G], with the noise of one pixel in all regions; 0 for invisible ones."""
        values, vectors = np.linalg.eigh(self.normals)
        limit = _SEEN * np.median(values[..., 1][values[..., 1] > 0]) if (values > 0).any() else 1.0
        root = np.where(values > limit, 1 / np.sqrt(np.maximum(values, 1e-30)), 0)
        b = np.einsum(
            "fgij,fgi->fgj", np.broadcast_to(vectors, (len(self.sides), *vectors.shape[1:])), self.sides
        )
        return (root * b).reshape(len(b), -1)

    def phasors(self, functions: np.ndarray) -> np.ndarray:
        """Return [K, G, 2] complex: of least squares with functions of time [2K, F], as `sinusoids` gives them.

        Sums b_f over the functions, to be divided by A: E m. For one fixed camera. A constant and a trend are fitted
        besides.
        """
        design = np.concatenate([constant_and_trend(self.times_s), functions]).T
        solution = np.linalg.lstsq(design, self.sides.reshape(len(self.sides), -1), rcond=None)[0][2:]
        pairs = solution.reshape(-1, 2, *self.sides.shape[1:])
        return pairs[:, 0] + 1j * pairs[:, 1]


def region_series(seen: FixedCameras, problem: Problem, checkpoint: Checkpoint) -> list[RegionSeries]:
    """Every fixed camera's region shifts."""
    labels, out = problem.aggregates.labels, []
    with progress("region shifts", len(seen.views), "cameras") as update:
        for v, frames in enumerate(seen.observations.frames):

            def compute(v: int = v, frames: PosedFrames = frames) -> Arrays:
                pictures = whole_pictures(seen.observations, frames.rows)
                return shift_series(seen.model(v), labels, (p - seen.sums.mean[v] for p in pictures)).arrays()

            out.append(RegionSeries(frames.times_s, **checkpoint(Step.regions.numbered(v), compute)))
            update(v + 1)
    return out


def shift_series(model: ObservationModel, labels: np.ndarray, changes: Iterable[np.ndarray]) -> RegionSeries:
    """The shifts in one pose's changes [f, H, W, 3], a few frames at a time; labels [N]: every Gaussian's region."""
    axes = model.frames.viewmat[:2, :3].astype(np.float64)
    sides = [_summed(model.adjoint(some)[..., :3] @ axes.T, labels) for some in changes]
    return RegionSeries(
        model.frames.times_s, np.concatenate(sides), _normals(model, labels, axes)[None], axes[None]
    )


def _normals(model: ObservationModel, labels: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return [G, 2, 2] by Hutchinson's estimator: with random signs of the regions, products between regions cancel."""
    rng, count = np.random.default_rng(0), int(labels.max()) + 1
    signs = rng.choice(np.array([-1.0, 1.0]), (_PROBES, count))
    motions = np.zeros((2 * _PROBES, len(labels), DOF), np.float32)
    for p in range(_PROBES):
        for a in range(2):
            motions[2 * p + a, :, :3] = signs[p, labels, None] * axes[a]
    sums = _summed(model.normal(motions)[..., :3] @ axes.T, labels).reshape(_PROBES, 2, count, 2)
    mean = (sums * signs[:, None, :, None]).mean(0).transpose(1, 0, 2)
    values, vectors = np.linalg.eigh((mean + mean.transpose(0, 2, 1)) / 2)
    return np.einsum("gij,gj,gkj->gik", vectors, np.maximum(values, 0), vectors)


def moving_camera_series(
    models: Sequence[ObservationModel], changes: Iterable[np.ndarray], labels: np.ndarray
) -> RegionSeries:
    """The shifts in a moving camera's frames [H, W, 3] less what is rendered at rest, each with its own model."""
    times_s: list[np.ndarray] = []
    each: list[Arrays] = []
    with progress("region shifts", len(models), "frames") as update:
        for k, (model, change) in enumerate(zip(models, changes, strict=True)):
            series = shift_series(model, labels, [change[None]])
            each.append(series.arrays())
            times_s.append(series.times_s)
            model.release()
            update(k + 1)
    return RegionSeries(np.concatenate(times_s), **concatenated(each))


def _summed(values: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return [F, G, 2]: sums of [F, N, 2] over regions."""
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(int(labels.max()) + 1))
    return np.add.reduceat(values[:, order].astype(np.float64), starts, axis=1)


@dataclass(frozen=True)
class SinusoidalModel(TemporalModel):
    """Functions 2k and 2k + 1 of time are cosine and −sine of frequency k; further ones are no motion."""

    frequencies: Frequencies
    scale: float  # of the cosines and sines: fields times it are phasors
    min_reliability: ClassVar[float]  # reliability below which a frequency is noise

    @property
    def hz(self) -> np.ndarray:
        """Return [K], by falling strength."""
        return self.frequencies.hz

    @property
    def is_asked(self) -> np.ndarray:
        """Return [K] bool: which lie in the requested band, and are kept whatever their error."""
        band = asked_band(self.config.band, self.observations.fps)
        return in_band(self.hz, band) if band is not None else np.zeros(len(self.hz), bool)

    def settled(self, folds: np.ndarray) -> tuple[Self, np.ndarray]:
        """The frequencies' fields, of those on which two folds agree."""
        folds = self.fix_gauge(folds[:, : 2 * len(self.hz)])
        is_reliable = (_reliability_of_pairs(folds) >= self.min_reliability) | self.is_asked
        return self._with(is_reliable), folds[:, np.repeat(is_reliable, 2)]

    def _with(self, keep: np.ndarray) -> Self:
        """Return only the frequencies `keep` [K] bool; the log names all if none remains."""
        rows, frequencies = np.repeat(keep, 2), self.frequencies.selected(keep)
        mixing = [m[:, : len(rows)][:, rows] for m in self.problem.mixing or ()]
        return replace(
            self,
            frequencies=frequencies,
            problem=self.problem.changed(mixing=mixing),
            figures=self.figures | frequency_figures(frequencies) if keep.any() else self.figures,
        )

    def fix_gauge(self, folds: np.ndarray) -> np.ndarray:
        """Return fields [P, 2K, N, 6] with a fixed gauge, which the cameras do not determine."""
        return folds

    def pixels_moved(self, fields: np.ndarray) -> float:
        """Return the motion of the strongest frequency, pixels."""
        return float(np.hypot(*pixels_moved(self.problem.views, fields[:2, :, :3] * np.float32(self.scale))))

    def peaks_hz(self, motion: ModalMotion, noise: np.ndarray | None) -> np.ndarray:
        return self.hz

    def motion(self, fields: np.ndarray, appearance: np.ndarray | None) -> ModalMotion:
        """Return the modes by ascending frequency."""
        hz, order = np.asarray(self.hz, np.float64), np.argsort(self.hz)
        series = self.scale * np.kron(np.eye(len(hz)), [1, 1j])[order]
        of_time = self.observations.fps, self.observations.n_timesteps
        return ModalMotion(hz[order], np.asarray(fields, np.float32), series, *of_time)


def frequencies_of(
    observations: Observations,
    series: Sequence[RegionSeries],
    least: float,
    lowest_hz: float,
    config: MotionConfig,
) -> tuple[Frequencies, dict[str, Any]]:
    """Find frequencies in all clocks' region shifts, from two periods (or `lowest_hz`) to half the frame rate.

    Those whose power is at least `least` times that of the noise. In the band that was asked for there is always one:
    where none stands out, that of the tone there (`core/lines/band.py`). Also return its relative error for the log.
    """
    highest, lowest = _HIGHEST * observations.fps / 2, max(lowest_hz, observations.lowest_hz)
    shifts, times = [s.whitened() for s in series], [s.times_s for s in series]
    found = Frequencies(np.zeros(0), np.zeros(0))
    if lowest < highest:
        found = find_frequencies(shifts, times, lowest, highest, least)
    band = asked_band(config.band, observations.fps)
    if band is None or in_band(found.hz, band).any():
        return found, {}
    tone = _tone_of(shifts, times, band)
    hz, deviation = np.append(found.hz, tone.hz), np.append(found.deviation_hz, tone.hz_deviation)
    share = float(np.linalg.norm(tone.amplitude_deviation) / max(float(np.linalg.norm(tone.phasor)), 1e-300))
    return Frequencies(hz, deviation), {"asked_hz": round(tone.hz, 6), "asked_share": round(share, 6)}


def _tone_of(
    shifts: Sequence[np.ndarray], times: Sequence[np.ndarray], band: tuple[float, float]
) -> BandLine:
    """Return the tone of the clock that shows most, in the region shifts that move most.

    Raises Tg4mmError where none has enough.
    """
    tones: list[BandLine] = []
    for y, t in zip(shifts, times, strict=True):
        if len(t) >= FEWEST or len(shifts) == 1:
            strongest = np.argsort(np.std(y - y.mean(0), axis=0))[::-1][:_STRONGEST]
            tones.append(tone_in(y[:, strongest], t, band))
    return max(tones, key=lambda tone: float(np.linalg.norm(tone.phasor)))


def in_band(hz: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    """Return [K] bool, ends included."""
    return np.asarray((hz >= band[0]) & (hz <= band[1]))


def frequency_figures(frequencies: Frequencies) -> dict[str, Any]:
    """Return figures for the log."""
    return {
        "frequencies_hz": [round(float(f), 4) for f in frequencies.hz],
        "frequency_deviation_hz": [round(float(f), 5) for f in frequencies.deviation_hz],
    }


def no_targets(observations: Observations) -> TargetImages:
    """Return target images of no function of time."""
    n, (width, height) = len(observations.frames), observations.size
    nothing = np.zeros((n, 0, height, width, 3), np.float32)
    basis, blank = np.zeros((0, observations.n_timesteps)), np.zeros((n, height, width), np.float32)
    return TargetImages(basis, np.zeros(observations.n_timesteps), nothing, blank, 1, nothing[:, 0:0])


def _reliability_of_pairs(folds: np.ndarray) -> np.ndarray:
    """Return the reliability [K] of sine and cosine together, from fields [2, 2K, N, 6] of two halves; 1 of one."""
    if len(folds) == 1:
        return np.ones(folds.shape[1] // 2)
    a, b = (half[..., :3].reshape(half.shape[0] // 2, -1, 3) for half in folds)
    return reliability((a + b) / 2, a, b)
