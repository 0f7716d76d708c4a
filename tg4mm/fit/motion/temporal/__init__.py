"""Temporal models: which functions of time the motion of a capture is fitted by, and how each view sees them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Checkpoint
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.hyperparameters import Hyperparameters
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.targets import TargetImages


@dataclass(frozen=True)
class TemporalModel(ABC):
    """A capture posed as one least-squares problem of R functions of time, and what the fields that solve it mean.

    `synchronous.py`: principal components over time. `independent.py`: sinusoids, with a phase of its own for each
    camera. `moving.py`: sinusoids and slow polynomials, every frame a view. Where R is 0 nothing moves.
    """

    gaussians: Gaussians  # at rest
    observations: Observations
    problem: Problem  # views, prior, nuisance, C_v
    targets: TargetImages
    folds: Sequence[Fold]
    config: MotionConfig
    figures: dict[str, Any]  # for the log
    notes: Sequence[str]  # limits of the result
    fitted: np.ndarray  # [ρ'] which of the target images
    # on the motion at a frequency: what the user can do
    if_halves_disagree: ClassVar[str] = "use longer clips"

    @property
    def separates(self) -> bool:
        """Return whether each function of time has separate target images, so that fields are solved for one by one."""
        return self.problem.mixing is None

    @property
    def iterates(self) -> bool:
        """Return whether large motion can be fitted by Gauss-Newton: with several cameras or photographs of a sweep."""
        return self.separates and not self.observations.is_flat

    @property
    def n_frames(self) -> int:
        """Number of frames in one camera's record."""
        return self.observations.n_timesteps

    def images(self, v: int) -> np.ndarray:
        """Return [ρ, H, W, 3]: target images of view v that are fitted."""
        return self.targets.of(v, self.fitted)

    @abstractmethod
    def strongest(self) -> tuple[np.ndarray, Problem, Sequence[Fold]]:
        """Return target images [V, ρ, H, W, 3] for choosing the smoothness weight, with their problem and folds."""

    @abstractmethod
    def completed(self, hyper: Hyperparameters, checkpoint: Checkpoint) -> "TemporalModel":
        """Complete the functions of time: choose the fitted ones, or find every camera's phases."""

    @property
    def first_iterations(self) -> int:
        """Iterations of conjugate gradients in a fit without a support."""
        return self.config.iterations

    def support(self, folds: np.ndarray) -> np.ndarray | None:
        """Return [R, N] float32: 1 for Gaussians that may move in the next fit, else 0; by the fields [P, R, N, 6].

        None where one fit is enough.
        """
        return None

    @abstractmethod
    def settled(self, folds: np.ndarray) -> "tuple[TemporalModel, np.ndarray]":
        """Return the model with its functions of time only, and the motion in fields [P, R, N, 6] of the folds.

        Functions that are no motion are let go, and what the cameras leave open is settled.
        """

    def ground_squares(self) -> np.ndarray | None:
        """Return squares [N] of the fields' error from not knowing what stands still; None if that is known."""
        return None

    @abstractmethod
    def pixels_moved(self, fields: np.ndarray) -> float:
        """Return the visible motion of fields [R, N, 6], pixels."""

    @abstractmethod
    def motion(self, fields: np.ndarray, appearance: np.ndarray | None) -> ModalMotion:
        """The modes of fields [R, N, 6], and of changes of colour [R, N, K, 3] that go with them."""

    @abstractmethod
    def peaks_hz(self, motion: ModalMotion, noise: np.ndarray | None) -> np.ndarray:
        """Frequencies of the motion's peaks, by falling strength. noise [N]: of `split_half_uncertainty`."""
