"""Fixed cameras on one clock: time and space separate, with one field for each function of time.

The functions are sinusoids and principal components of the products G [T, T] of all changes of all cameras together.
C_v is the identity, so that the fields can be solved for one by one.

With noise a principal component is only partly the time course of a vibration: it is the direction in T dimensions in
which motion and noise together are largest, and the same motion a quarter of a period later is a weaker component,
which noise may hide. A sinusoid has one frequency, determined by all frames, and its cosine and sine contain every
phase. So where a sinusoid stands out, it is used, and components represent the rest.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tg4mm.core.lines import fit_lines
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Checkpoint
from tg4mm.fit.motion.config import MotionConfig, asked_band
from tg4mm.fit.motion.hyperparameters import Hyperparameters
from tg4mm.fit.motion.jacobian.view import pixels_moved
from tg4mm.fit.motion.mode_selection import peaks
from tg4mm.fit.motion.modes import AppearanceModes, ModalMotion
from tg4mm.fit.motion.nuisance.fixed_cameras import PictureSums, prepare_fixed_cameras
from tg4mm.fit.motion.nuisance.projection import Nuisance
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.spectrum import modes_of
from tg4mm.fit.motion.split_half import folds_of
from tg4mm.fit.motion.targets import TargetImages, projected
from tg4mm.fit.motion.temporal import TemporalModel

_RELATIVE_FLOOR = 1e-5  # of the first component's energy: below it is rounding
_NOISE_FACTOR = 2.0  # times the energy of the weakest components: below it is noise, at most
_MARGIN = 1.1
_RANK_FOR_NOISE = 7
_DISTINCT = 0.05  # of the largest singular value: courses that differ by less are one
_ROUNDING = 1e-7  # of the first component's energy: what sums in float32 leave of nothing
_FEWEST = 12  # timesteps for a sinusoid, `fit_lines`' own
_MOST = 3  # sinusoids
_TONAL = 0.7  # of the energy that stands out of the noise: what sinusoids must hold
_LEADING = 3  # components that a frequency is refined by
_APART, _OVERSAMPLED = 0.75, 8  # bins to half the frame rate; frequencies tried in each
_LARGEST = 24  # timesteps whose motion is looked at


def sinusoidal_courses(gram: np.ndarray, pixels: float, times_s: np.ndarray) -> np.ndarray | None:
    """Return cosine and sine [2K, T] of the K vibrations in changes with products `gram` [T, T]; None if none.

    The strongest is first; each must exceed the largest value of noise over `pixels` in any two directions (Marchenko &
    Pastur 1967). The fewest are used that contain 70 % of the energy above the noise, if together with the components
    of the residual they are at most one function per sinusoid more than the components alone.
    """
    n_timesteps = len(gram)
    alone, above = _standing_out(gram, pixels)
    if n_timesteps < _FEWEST or rank_of(falling_energy(gram)) < _RANK_FOR_NOISE:
        return None
    courses, rest, count = np.zeros((0, n_timesteps)), gram, 0
    for k in range(1, _MOST + 1):
        found = _strongest(rest, times_s)
        centred = orthonormal(found, rest)
        energy = falling_energy(rest)
        taken, rank = float(np.einsum("kt,ts,ks->", centred, rest, centred)), rank_of(energy)
        noise = (energy.sum() - taken) / max(rank - len(centred), 1)
        if taken <= len(centred) * (1 + np.sqrt(rank / max(pixels, 2 * rank))) ** 2 * noise:
            return None
        courses = np.concatenate([courses, found])
        span = orthonormal(courses, gram)
        rest = gram - span.T @ (span @ gram)
        rest = rest - (rest @ span.T) @ span
        count, left = _standing_out(rest, pixels)
        if left <= (1 - _TONAL) * above:
            return courses if len(span) + count <= max(alone, 1) + k else None
    return None


def _strongest(gram: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Return [2, T]: cosine and sine of the strongest frequency, with the decay that its record shows."""
    energy, vectors = np.linalg.eigh(gram)
    series = vectors[:, ::-1] * np.sqrt(np.maximum(energy[::-1], 0))
    step = float(np.median(np.diff(times_s)))
    # of an even clock, whose missing frames are empty
    at = np.round((times_s - times_s[0]) / step).astype(int)
    n = int(at[-1]) + 1
    even = np.zeros((n, len(gram)))
    even[at] = series
    power = (np.abs(np.fft.rfft(even, _OVERSAMPLED * n, axis=0)) ** 2).sum(1)
    cycles = np.arange(len(power)) / _OVERSAMPLED
    allowed = (cycles >= 1) & (cycles <= n / 2 - _APART)
    start = cycles[np.where(allowed, power, -1).argmax()] / (n * step)
    line = fit_lines(series[:, :_LEADING], times_s, [start]).lines[0]
    angles = 2 * np.pi * line.hz * times_s
    return np.asarray(line.envelope(times_s) * np.stack([np.cos(angles), np.sin(angles)]))


def _standing_out(gram: np.ndarray, pixels: float) -> tuple[int, float]:
    """Return the number of components that stand out of the noise, and their energy."""
    energy = falling_energy(gram)
    rank = rank_of(energy)
    if rank < _RANK_FOR_NOISE:
        return 0, 0.0
    count = kept_components(energy, rank, pixels, least=0)
    noise = float(energy[count:rank].mean()) if count < rank else 0.0
    return count, float((energy[:count] - noise).sum())


def falling_energy(gram: np.ndarray) -> np.ndarray:
    """Return [T] energies of the principal components of products [T, T], the largest first."""
    return np.maximum(np.linalg.eigvalsh(gram)[::-1], 0)


def rank_of(energy: np.ndarray) -> int:
    """Return the number of components of falling `energy` [T] above rounding; the last, the mean's, is empty."""
    return int((energy[:-1] > _ROUNDING * energy[0]).sum())


def orthonormal(courses: np.ndarray | None, gram: np.ndarray) -> np.ndarray:
    """Return [K, T] orthonormal functions of mean 0 that span courses [C, T], the strongest in the pictures first."""
    if courses is None or not len(courses):
        return np.zeros((0, len(gram)))
    centred = courses - courses.mean(1, keepdims=True)
    _, sizes, span = np.linalg.svd(
        centred / np.linalg.norm(centred, axis=1, keepdims=True), full_matrices=False
    )
    span = span[sizes > _DISTINCT * sizes[0]]
    _, turn = np.linalg.eigh(span @ gram @ span.T)
    return np.asarray(turn[:, ::-1].T @ span)


def kept_components(energy: np.ndarray, rank: int | None = None, pixels: float = 0.0, least: int = 1) -> int:
    """Return the number of components of falling `energy` [T] above rounding and noise, at least `least`.

    Noise has the same level in all components except empty ones: one of the T, since the mean is removed, and more if
    pictures repeat (`rank` are not empty). So the level is the mean of the weakest quarter of the others. With fewer
    than seven, everything above rounding is kept. The spread of noise over components depends on the number of `pixels`
    (Marchenko & Pastur 1967); if that is unknown or small, twice the level counts as noise.
    """
    used = len(energy) - 1 if rank is None else rank
    floor = _RELATIVE_FLOOR * energy[0]
    if used >= _RANK_FOR_NOISE:
        root = np.sqrt(used / max(pixels, 2 * used))
        factor = min(_MARGIN * ((1 + root) / (1 - root)) ** 2, _NOISE_FACTOR)
        floor = max(floor, factor * float(energy[used - used // 4 : used].mean()))
    return max(int((energy[:used] > floor).sum()), least)


def effective_pixels(total: np.ndarray) -> float:
    """Return over how many pixels energy [V, H, W] is spread: all if alike in all, 1 if in one."""
    squares = np.einsum("vhw,vhw->", total, total, dtype=np.float64)
    return float(total.sum(dtype=np.float64) ** 2 / squares) if squares else 0.0


@dataclass(frozen=True)
class Synchronous(TemporalModel):
    """`TemporalModel` of cameras that film at the same times."""

    @staticmethod
    def of(
        gaussians: Gaussians,
        observations: Observations,
        config: MotionConfig,
        device: str,
        checkpoint: Checkpoint,
    ) -> "Synchronous":
        """Reduce the pictures, without nuisance, to few components."""
        seen = prepare_fixed_cameras(gaussians, observations, config, device, checkpoint)
        targets = principal_components(seen.observations, seen.sums, seen.nuisances, config)
        folds = folds_of(len(seen.views), observations.size, False, config.split_half)
        return Synchronous(
            seen.gaussians, seen.observations, seen.problem(config, device), targets, folds, config,
            seen.figures, seen.notes, np.arange(len(targets.basis)),
        )  # fmt: skip

    @property
    def n_frames(self) -> int:
        return len(self.observations.frames[0].rows)

    @property
    def basis(self) -> np.ndarray:
        """Return [R, F]: the functions of time."""
        return self.targets.basis[self.fitted]

    @property
    def own_basis(self) -> np.ndarray:
        """Return [R, F]: `basis`, known vibrations as they are, not as B-frames show them."""
        shown, own, basis = self.observations.time_courses, self.observations.own_courses, self.basis
        known = self.fitted < self.targets.n_known
        if shown is None or own is None or not known.any():
            return basis
        weights = np.linalg.lstsq((shown - shown.mean(1, keepdims=True)).T, basis[known].T, rcond=None)[0]
        out = basis.copy()
        out[known] = weights.T @ (own - own.mean(1, keepdims=True))
        return out

    def strongest(self) -> tuple[np.ndarray, Problem, Sequence[Fold]]:
        return self.targets.images[:, :1], self.problem, self.folds

    def completed(self, hyper: Hyperparameters, checkpoint: Checkpoint) -> "Synchronous":
        """The components that are not noise."""
        energy, signal = self.targets.energy, hyper.signal
        if self.config.band and not len(signal):
            signal = np.arange(1)  # what was asked for is fitted; its ± says how little it is
        figures = {
            "components": len(signal),
            "components_of_noise": int(hyper.is_noise.sum()),
            "explained_by_components": float(energy[signal].sum() / max(energy.sum(), 1e-30)),
        }
        return replace(self, fitted=signal, figures=self.figures | figures)

    def settled(self, folds: np.ndarray) -> "tuple[Synchronous, np.ndarray]":
        return self, folds

    def pixels_moved(self, fields: np.ndarray) -> float:
        """Return the motion in pixels at the timesteps at which it is largest."""
        views, displacement = self.problem.views, fields[..., :3]
        basis = self.own_basis.T
        sizes = np.linalg.norm(basis * pixels_moved(views, displacement), axis=1)
        gains = basis[np.argsort(sizes)[-_LARGEST:]]
        return float(pixels_moved(views, np.tensordot(gains, displacement, 1).astype(np.float32)).max())

    def motion(self, fields: np.ndarray, appearance: np.ndarray | None) -> ModalMotion:
        fps, n_timesteps = self.observations.fps, self.observations.n_timesteps
        band, times_s = asked_band(self.config.band, fps), self.observations.frames[0].times_s
        known = self.observations.steady_hz
        freqs, series = modes_of(self.own_basis, fields, fps, appearance, band, times_s, known)
        shown = None
        if appearance is not None and (rows := np.flatnonzero(appearance.any((1, 2, 3)))).size:
            shown = AppearanceModes(appearance[rows], series[:, rows])
        return ModalMotion(freqs, np.asarray(fields, np.float32), series, fps, n_timesteps, appearance=shown)

    def peaks_hz(self, motion: ModalMotion, noise: np.ndarray | None) -> np.ndarray:
        return peaks(motion, self.observations.lowest_hz, noise, self.observations.steady_hz)


def principal_components(
    observations: Observations, sums: PictureSums, nuisances: Sequence[Nuisance], config: MotionConfig
) -> TargetImages:
    """Time courses of vibrations, and principal components of the remaining changes of all synchronous cameras.

    The courses are known (`Observations.time_courses`) or sinusoids that stand out of the noise. A vibration of a small
    part of a large picture is no principal component: there the noise of all pixels is stronger. Of the components
    there are at most as many as the settings say. What the active nuisance columns explain of a frame is taken out
    first.
    """
    gram = np.zeros_like(sums.grams[0])
    for v, nuisance in enumerate(nuisances):
        gram += sums.grams[v] - nuisance.explained_gram(sums.mean[v], sums.columns[v])
    pixels = effective_pixels(sums.total)
    courses = observations.time_courses
    if courses is None and config.sinusoids and not observations.is_flat:
        courses = sinusoidal_courses(gram, pixels, observations.frames[0].times_s)
    known = orthonormal(courses, gram)
    known_energy = np.einsum("kt,ts,ks->k", known, gram, known)
    gram -= known.T @ (known @ gram)
    gram -= (gram @ known.T) @ known
    energy, vectors = np.linalg.eigh(gram)
    energy, vectors = np.maximum(energy[::-1], 0), vectors[:, ::-1].T
    rank = rank_of(energy)
    count = kept_components(energy, rank, pixels, least=0 if len(known) else 1)
    if count > (most := config.components):
        warnings.warn(
            f"{count} temporal components exceed the noise, motion.components keeps the strongest {most}",
            stacklevel=2,
        )
    basis = np.concatenate([known, vectors[: min(count, most)]])
    basis = basis - basis.mean(1, keepdims=True)  # zero already, but for rounding
    images, residual = projected(observations, sums, nuisances, [basis] * len(sums.grams))
    n_known = len(known)
    energy = np.concatenate([known_energy, energy[: len(energy) - n_known]])
    return TargetImages(basis, energy, images, residual, max(rank, 1) + n_known, sums.mean, n_known)
