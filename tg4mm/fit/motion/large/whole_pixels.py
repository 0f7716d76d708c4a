"""Motion of whole pixels before one fixed camera: put it back, fit what is left, and again.

Every picture is resampled so that its parts lie where they are at rest (`resampling.py`). The mean of these pictures is
sharp, and the scene at rest is fitted to it. The motion that is left is small. Its target images and those of the
motion put back are fitted together, like any others, so that prior, noise and halves of the data apply to all of the
motion. An iteration counts if the pictures, put back by its motion, differ less from each other.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tg4mm.core.memory import Buffers, release
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step, arrays_of, gaussians_of, suffixed
from tg4mm.fit.motion.hyperparameters import Hyperparameters
from tg4mm.fit.motion.jacobian.view import false_changes, optical_flow, view_jacobian
from tg4mm.fit.motion.large import iterated
from tg4mm.fit.motion.large.registration import mean_pictures
from tg4mm.fit.motion.large.resampling import put_back
from tg4mm.fit.motion.observations import Observations, PosedFrames
from tg4mm.fit.motion.split_half import wiener_shrink
from tg4mm.fit.motion.temporal import TemporalModel
from tg4mm.fit.motion.temporal.synchronous import Synchronous
from tg4mm.fit.space.plane import plane_gaussians, solve_colours

# pixels, rms: smaller motion is not put back, larger motion completely. Far below the linear range
_LEFT, _PUT_BACK = 0.1, 0.3
_NEAREST = 8  # Gaussians that one of the new scene takes its motion from


@dataclass(frozen=True)
class LinearSolution:
    """Fields of both folds for a model's functions of time, with the hyperparameters of the fit."""

    model: TemporalModel
    hyper: Hyperparameters
    folds: np.ndarray  # [P, R, N, 6]
    gradients: np.ndarray  # [R, 4N, 3]

    @property
    def fields(self) -> np.ndarray:
        """Return [R, N, 6]: the motion on which the folds agree."""
        return wiener_shrink(self.folds)[0]

    @property
    def vibration(self) -> np.ndarray:
        """Return [R, N, 6]: `fields` of the vibrations found by region, which are removed first; 0 for other motion."""
        fields = self.fields.copy()
        fields[self.model.targets.n_known :] = 0
        return fields

    @property
    def basis(self) -> np.ndarray:
        """Return [R, T]: the functions of time."""
        return self.model.targets.basis[self.model.fitted]


@dataclass(frozen=True)
class _PutBack:
    """A model of pictures put back by fields [K, N, 6] of its first K functions of time."""

    model: TemporalModel
    fields: np.ndarray

    @property
    def left(self) -> float:
        """Sum over pictures and pixels of squared differences from their mean."""
        targets, total = self.model.targets, 0.0
        for image in targets.images[0]:
            total += float(np.einsum("hwc,hwc->", image, image, dtype=np.float64)) / 3
            release(targets.images)
        return total + float(targets.residual_energy.sum(dtype=np.float64))

    def complete(self) -> TemporalModel:
        """Return the model whose target images include the motion put back; the strongest function of time first."""
        model, fields, n = self.model, self.fields, len(self.fields)
        shifts = fields[..., :3].reshape(n, -1).astype(np.float64)
        turn = np.linalg.eigh(shifts @ shifts.T)[1][:, ::-1].T
        targets, problem = model.targets, model.problem
        images, basis, energy = targets.images, targets.basis.copy(), targets.energy.copy()
        view, mean = problem.views[0], targets.mean[0]
        shown = np.array(view.jvp(fields)) - false_changes(view, mean, fields)
        together = images[0, :n] + problem.without_nuisance(0, shown)
        images[0, :n] = np.tensordot(turn.astype(np.float32), together, 1)
        energy[:n] = np.einsum("rhwc,rhwc->r", images[0, :n], images[0, :n], dtype=np.float64)
        release(images)
        basis[:n] = turn @ basis[:n]
        return replace(model, targets=replace(targets, basis=basis, energy=energy))


def solve_whole_pixels(
    first: LinearSolution,
    solve: Callable[[TemporalModel, Checkpoint], LinearSolution],
    checkpoint: Checkpoint,
) -> tuple[LinearSolution, int]:
    """Iterate a flat capture's solution, `config.gauss_newton` times at most; return it and the number that counted.

    solve: hyperparameters and the linear fit of a model.
    """
    observations = first.model.observations

    def named(k: int) -> Checkpoint:
        return suffixed(checkpoint, Step.whole_pixels.numbered(k))

    def step(
        state: tuple[LinearSolution, _PutBack | None], k: int
    ) -> tuple[tuple[LinearSolution, _PutBack], float] | None:
        found, last = state
        if last is not None:
            found = solve(last.complete(), named(k - 1))
        if not found.folds.shape[1]:
            return None
        there = _put_back(found, observations, named(k))
        return (found, there), there.left

    start: tuple[LinearSolution, _PutBack | None] = first, None
    left = _PutBack(first.model, np.zeros(0)).left
    (solution, _), lefts = iterated(start, left, step, first.model.config.gauss_newton + 1, of_gain=True)
    return solution, max(len(lefts) - 2, 0)


def _put_back(last: LinearSolution, observations: Observations, checkpoint: Checkpoint) -> _PutBack:
    """Pictures put back by the last solution, and a scene at rest that shows their mean."""
    model, frames = last.model, observations.frames[0]
    assert isinstance(model, Synchronous)
    gaussians, n_known = model.gaussians, last.model.targets.n_known
    basis, own = last.basis[:n_known], model.own_basis[:n_known]
    fields = _large(last.vibration[: len(basis)], frames)

    def displaced(gaussians: Gaussians, fields: np.ndarray) -> Observations:
        view = view_jacobian(gaussians, frames, observations.size)
        flow = np.ascontiguousarray(optical_flow(view, fields, Buffers())[..., :2])
        pictures = put_back(observations.pictures, frames, flow, basis)
        return replace(observations, pictures=pictures, time_courses=basis, own_courses=own)

    def sharper() -> Arrays:
        mean = mean_pictures(displaced(gaussians, fields))[0]
        scene = plane_gaussians(mean, frames.K, frames.viewmat, len(gaussians))
        return arrays_of(solve_colours(scene, mean, frames.viewmat, frames.K).detach())

    if not observations.is_part:
        scene = gaussians_of(checkpoint(Step.scene, sharper))
        fields = _interpolated(gaussians.means.numpy(), fields, scene.means.numpy())
        gaussians = scene
    # the nuisance found before is taken out again
    nuisance = {0: "none", 1: "exposure"}.get(len(model.figures["nuisance"]), "all")
    config = replace(model.config, nuisance=nuisance)
    again = Synchronous.of(gaussians, displaced(gaussians, fields), config, model.problem.device, checkpoint)
    n = again.targets.n_known
    moved = np.tensordot(again.targets.basis[:n] @ basis.T, fields, 1)
    return _PutBack(again, np.ascontiguousarray(moved, np.float32))


def _large(fields: np.ndarray, frames: PosedFrames) -> np.ndarray:
    """Return [R, N, 6]: the fields, 0 for Gaussians that hardly move."""
    across = fields[..., :3] @ frames.viewmat[:2, :3].T * np.diag(frames.K)[:2]  # at distance 1
    moved = np.sqrt((across.astype(np.float64) ** 2).sum((0, 2)) / len(frames.rows))
    return np.asarray(fields * np.clip((moved - _LEFT) / (_PUT_BACK - _LEFT), 0, 1)[:, None], np.float32)


def _interpolated(means: np.ndarray, fields: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return [R, M, 6]: fields [R, N, 6] of Gaussians at `means` [N, 3] at other places [M, 3], by distance."""
    distance, nearest = cKDTree(means).query(at, k=min(_NEAREST, len(means)))
    weights = 1 / (distance + 1e-9) ** 2
    weights /= weights.sum(1, keepdims=True)
    return np.asarray(np.einsum("rmkd,mk->rmd", fields[:, nearest], weights), np.float32)
