"""Fixed cameras on one clock: time separates from space, one field for each function of time.

The functions are sinusoids and principal components of all changes of all cameras together (`time_courses.py`). C_v is
the identity, so that the fields can be solved for one by one.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Checkpoint
from tg4mm.fit.motion.config import MotionConfig, asked_band
from tg4mm.fit.motion.hyperparameters import Hyperparameters
from tg4mm.fit.motion.jacobian.pixels import pixels_moved
from tg4mm.fit.motion.mode_selection import peaks
from tg4mm.fit.motion.modes import AppearanceModes, ModalMotion
from tg4mm.fit.motion.nuisance.first_look import FirstLook, look_at
from tg4mm.fit.motion.nuisance.projection import Nuisance
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.spectrum import apply_series, modes_of
from tg4mm.fit.motion.split_half import folds_of
from tg4mm.fit.motion.targets import TargetImages, projected
from tg4mm.fit.motion.temporal import TemporalModel
from tg4mm.fit.motion.temporal.time_courses import (
    effective_pixels,
    kept_components,
    orthonormal,
    rank_of,
    sinusoidal_courses,
)

_LARGEST = 24  # timesteps whose motion is looked at


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
        """What the cameras saw, less what is no motion of the scene, in few components."""
        seen = look_at(gaussians, observations, config, device, checkpoint)
        targets = principal_components(seen.observations, seen.look, seen.nuisances, config)
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
        """[R, F]: the functions of time."""
        return self.targets.basis[self.fitted]

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
        """At the timesteps at which it is largest."""
        views, displacement = self.problem.views, fields[..., :3]
        sizes = np.linalg.norm(self.basis.T * pixels_moved(views, displacement), axis=1)
        gains = self.basis.T[np.argsort(sizes)[-_LARGEST:]]
        return float(pixels_moved(views, np.tensordot(gains, displacement, 1).astype(np.float32)).max())

    def motion(self, fields: np.ndarray, appearance: np.ndarray | None) -> ModalMotion:
        fps, n_timesteps = self.observations.fps, self.observations.n_timesteps
        band, times_s = asked_band(self.config.band, fps), self.observations.frames[0].times_s
        known = self.observations.steady_hz
        freqs, series = modes_of(self.basis, fields, fps, appearance, band, times_s, known)
        values = apply_series(series, fields)
        shown = None
        if appearance is not None and (rows := np.flatnonzero(appearance.any((1, 2, 3)))).size:
            shown = AppearanceModes(appearance[rows], series[:, rows])
        return ModalMotion(freqs, values[..., :3], values[..., 3:], fps, n_timesteps, appearance=shown)

    def peaks_hz(self, motion: ModalMotion, noise: np.ndarray | None) -> np.ndarray:
        return peaks(motion, self.observations.lowest_hz, noise, self.observations.steady_hz)


def principal_components(
    observations: Observations, look: FirstLook, nuisances: Sequence[Nuisance], config: MotionConfig
) -> TargetImages:
    """Time courses of vibrations, and principal components of what the changes of all synchronous cameras hold besides.

    The courses are known (`Observations.courses`) or sinusoids that stand out of the noise. A vibration of a small part
    of a large picture is no principal component: there the noise of all pixels is stronger. Of the components there
    are at most as many as the settings say. What the active nuisance columns explain of a frame is taken out first.
    """
    gram = np.zeros_like(look.grams[0])
    for v, nuisance in enumerate(nuisances):
        gram += look.grams[v] - nuisance.explained_gram(look.mean[v], look.columns[v])
    pixels = effective_pixels(look.total)
    courses = observations.courses
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
    images, residual = projected(observations, look, nuisances, [basis] * len(look.grams))
    n_known = len(known)
    energy = np.concatenate([known_energy, energy[: len(energy) - n_known]])
    return TargetImages(basis, energy, images, residual, max(rank, 1) + n_known, look.mean, n_known)
