"""A steady vibration, as cameras with clocks of their own and a moving camera see it: a few sinusoids.

Their frequencies are found first, from how regions of Gaussians shift in the pictures; then every frequency has two
fields, of its cosine and its sine.

How regions of Gaussians shift in a camera's picture, frame by frame: what frequencies and phases are found from. A
region's shift along the picture's rows and columns in one frame is the least-squares solution of that frame's change
through the Jacobian, nuisance projected out: b = Eᵀ Jᵀ Δ summed over the region, A = Eᵀ Jᵀ J E, shift = A⁻¹ b with E
the camera's right and down axes. Nothing is smoothed over space or time, so its noise is that of the pictures.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from tg4mm.core.lines.band import FEWEST, Tone, tone_in
from tg4mm.core.progress import progress
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, concatenated
from tg4mm.fit.motion.config import MotionConfig, asked_band
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.pixels import pixels_moved
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.nuisance.first_look import FixedCameras
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import Observations, PosedFrames, whole_pictures
from tg4mm.fit.motion.solver.aggregates import Aggregates
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.spectrum import constant_and_trend
from tg4mm.fit.motion.split_half import reliability
from tg4mm.fit.motion.targets import TargetImages
from tg4mm.fit.motion.temporal import TemporalModel
from tg4mm.fit.motion.temporal.frequencies import Frequencies, find_frequencies

_PROBES = 4
_STRONGEST = 32  # series that the tone in a band is taken from
_SEEN = 0.02  # of the median region's determinant: below it a region is not seen


@dataclass(frozen=True)
class RegionSeries:
    """Shifts of G regions in the F frames of one clock; a moving camera has axes and normal matrices per frame."""

    times_s: np.ndarray  # [F]
    sides: np.ndarray  # [F, G, 2] b, scene units⁻¹
    normals: np.ndarray  # [F or 1, G, 2, 2] A
    axes: np.ndarray  # [F or 1, 2, 3] right and down, unit vectors in the world

    def arrays(self) -> Arrays:
        """For a checkpoint."""
        return {"sides": self.sides, "normals": self.normals, "axes": self.axes}

    @staticmethod
    def restored(times_s: np.ndarray, arrays: Arrays) -> "RegionSeries":
        """From what `arrays` gave."""
        return RegionSeries(times_s, arrays["sides"], arrays["normals"], arrays["axes"])

    def whitened(self) -> np.ndarray:
        """[F, 2G]: A^(-1/2) b, whose noise is that of one pixel, alike for all regions; 0 where nothing is seen."""
        values, vectors = np.linalg.eigh(self.normals)
        limit = _SEEN * np.median(values[..., 1][values[..., 1] > 0]) if (values > 0).any() else 1.0
        root = np.where(values > limit, 1 / np.sqrt(np.maximum(values, 1e-30)), 0)
        b = np.einsum(
            "fgij,fgi->fgj", np.broadcast_to(vectors, (len(self.sides), *vectors.shape[1:])), self.sides
        )
        return (root * b).reshape(len(b), -1)

    def phasors(self, functions: np.ndarray) -> np.ndarray:
        """[K, G, 2] complex: of least squares with functions of time [2K, F], as `sinusoids` gives them.

        Sums b_f over the functions, to be divided by A: E m. For one fixed camera. A constant and a trend are fitted
        besides.
        """
        design = np.concatenate([constant_and_trend(self.times_s), functions]).T
        solution = np.linalg.lstsq(design, self.sides.reshape(len(self.sides), -1), rcond=None)[0][2:]
        pairs = solution.reshape(-1, 2, *self.sides.shape[1:])
        return pairs[:, 0] + 1j * pairs[:, 1]


def region_series(seen: FixedCameras, problem: Problem, checkpoint: Checkpoint) -> list[RegionSeries]:
    """Every fixed camera's region shifts."""
    labels, out = labels_of(problem.aggregates), []
    with progress("region shifts", len(seen.views), "cameras") as update:
        for v, frames in enumerate(seen.observations.frames):

            def compute(v: int = v, frames: PosedFrames = frames) -> Arrays:
                pictures = whole_pictures(seen.observations, frames.rows)
                return shift_series(seen.model(v), labels, (p - seen.look.mean[v] for p in pictures)).arrays()

            out.append(RegionSeries.restored(frames.times_s, checkpoint(f"regions_{v}", compute)))
            update(v + 1)
    return out


def labels_of(aggregates: Aggregates) -> np.ndarray:
    """[N] int: the region of every Gaussian, the aggregates of the solver's coarse level."""
    return np.asarray(aggregates.tentative.indices)


def shift_series(model: ObservationModel, labels: np.ndarray, changes: Iterable[np.ndarray]) -> RegionSeries:
    """The shifts in one pose's changes [f, H, W, 3], a few frames at a time; labels [N]: every Gaussian's region."""
    axes = model.frames.viewmat[:2, :3].astype(np.float64)
    sides = [_summed(model.adjoint(some)[..., :3] @ axes.T, labels) for some in changes]
    return RegionSeries(
        model.frames.times_s, np.concatenate(sides), _normals(model, labels, axes)[None], axes[None]
    )


def _normals(model: ObservationModel, labels: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """[G, 2, 2], by Hutchinson's estimator: with a random sign on each region, products between regions cancel."""
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
            own = shift_series(model, labels, [change[None]])
            each.append(own.arrays())
            times_s.append(own.times_s)
            model.release()
            update(k + 1)
    return RegionSeries.restored(np.concatenate(times_s), concatenated(each))


def _summed(values: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """[F, G, 2]: sums of [F, N, 2] over regions."""
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(int(labels.max()) + 1))
    return np.add.reduceat(values[:, order].astype(np.float64), starts, axis=1)


_HIGHEST = 0.98  # of half the frame rate


@dataclass(frozen=True)
class Steady(TemporalModel):
    """Functions 2k and 2k + 1 of time are cosine and −sine of frequency k; further ones are no motion."""

    frequencies: Frequencies
    scale: float  # of the cosines and sines: fields times it are phasors
    min_reliability: ClassVar[float]  # reliability below which a frequency is noise

    @property
    def hz(self) -> np.ndarray:
        """[K], by falling strength."""
        return self.frequencies.hz

    @property
    def is_asked(self) -> np.ndarray:
        """[K] bool: which lie in the band that was asked for, and stay however little is told of them."""
        band = asked_band(self.config.band, self.observations.fps)
        return in_band(self.hz, band) if band is not None else np.zeros(len(self.hz), bool)

    def settled(self, folds: np.ndarray) -> tuple[Self, np.ndarray]:
        """The frequencies' fields, of those on which two folds agree."""
        folds = self.fix_gauge(folds[:, : 2 * len(self.hz)])
        is_reliable = (_reliability_of_pairs(folds) >= self.min_reliability) | self.is_asked
        return self._with(is_reliable), folds[:, np.repeat(is_reliable, 2)]

    def _with(self, keep: np.ndarray) -> Self:
        """Only the frequencies `keep` [K] bool; the log names all where none is kept."""
        rows, frequencies = np.repeat(keep, 2), self.frequencies.selected(keep)
        mixing = [m[:, : len(rows)][:, rows] for m in self.problem.mixing or ()]
        return replace(
            self,
            frequencies=frequencies,
            problem=self.problem.changed(mixing=mixing),
            figures=self.figures | frequency_figures(frequencies) if keep.any() else self.figures,
        )

    def fix_gauge(self, folds: np.ndarray) -> np.ndarray:
        """Fields [P, 2K, N, 6], whose gauge is fixed: what the cameras leave open is chosen."""
        return folds

    def pixels_moved(self, fields: np.ndarray) -> float:
        """By the strongest frequency."""
        return float(np.hypot(*pixels_moved(self.problem.views, fields[:2, :, :3] * np.float32(self.scale))))

    def peaks_hz(self, motion: ModalMotion, noise: np.ndarray | None) -> np.ndarray:
        return self.hz

    def motion(self, fields: np.ndarray, appearance: np.ndarray | None) -> ModalMotion:
        """By ascending frequency."""
        values = (self.scale * (fields[0::2] + 1j * fields[1::2])).astype(np.complex64)
        order = np.argsort(self.hz)
        of_time = self.observations.fps, self.observations.n_timesteps
        return ModalMotion(
            np.asarray(self.hz, np.float64)[order], values[order, :, :3], values[order, :, 3:], *of_time
        )


def frequencies_of(
    observations: Observations,
    series: Sequence[RegionSeries],
    least: float,
    lowest_hz: float,
    config: MotionConfig,
) -> tuple[Frequencies, dict[str, Any]]:
    """From all clocks' region shifts, from two periods in the record (or `lowest_hz`) to half the frame rate.

    Those whose power is at least `least` times that of the noise. In the band that was asked for there is always one:
    where none stands out, that of the tone there (`core/lines/band.py`). Also for the log, how little is told of it.
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


def _tone_of(shifts: Sequence[np.ndarray], times: Sequence[np.ndarray], band: tuple[float, float]) -> Tone:
    """Return the tone of the clock that shows most, in the region shifts that move most.

    Raises Tg4mmError where none has enough.
    """
    tones: list[Tone] = []
    for y, t in zip(shifts, times, strict=True):
        if len(t) >= FEWEST or len(shifts) == 1:
            strongest = np.argsort(np.std(y - y.mean(0), axis=0))[::-1][:_STRONGEST]
            tones.append(tone_in(y[:, strongest], t, band))
    return max(tones, key=lambda tone: float(np.linalg.norm(tone.phasor)))


def in_band(hz: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    """[K] bool, ends included."""
    return np.asarray((hz >= band[0]) & (hz <= band[1]))


def frequency_figures(frequencies: Frequencies) -> dict[str, Any]:
    """For the log."""
    return {
        "frequencies_hz": [round(float(f), 4) for f in frequencies.hz],
        "frequency_deviation_hz": [round(float(f), 5) for f in frequencies.deviation_hz],
    }


def no_targets(observations: Observations) -> TargetImages:
    """Where there is no function of time."""
    n, (width, height) = len(observations.frames), observations.size
    nothing = np.zeros((n, 0, height, width, 3), np.float32)
    basis, blank = np.zeros((0, observations.n_timesteps)), np.zeros((n, height, width), np.float32)
    return TargetImages(basis, np.zeros(observations.n_timesteps), nothing, blank, 1, nothing[:, 0:0])


def _reliability_of_pairs(folds: np.ndarray) -> np.ndarray:
    """[K] of each frequency's sine and cosine together, of the fields [2, 2K, N, 6] of two halves; 1 of one fold."""
    if len(folds) == 1:
        return np.ones(folds.shape[1] // 2)
    a, b = (half[..., :3].reshape(half.shape[0] // 2, -1, 3) for half in folds)
    return reliability((a + b) / 2, a, b)
