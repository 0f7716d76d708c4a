"""Motion of whole pixels before one fixed camera: put it back, fit what is left, and again.

Pictures change in proportion to motion up to about .7 pixels, and a mean over larger motion is blurred. Where something
vibrates by more, every picture is resampled so that it lies where it is at rest (`nuisance/registration.py`). Their
mean is sharp, and the scene at rest is fitted to it. What motion is left is small. Its target images and those of the
motion put back are fitted together, as any others, so that prior, noise and halves of the data apply to the whole
motion. An iteration counts if the pictures, put back by what it found, differ less from each other.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tg4mm.core.memory import release
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, arrays_of, gaussians_of, suffixed
from tg4mm.fit.motion.hyperparameters import Hyperparameters
from tg4mm.fit.motion.jacobian.view import false_changes, optical_flow, view_jacobian
from tg4mm.fit.motion.nuisance.registration import mean_pictures, put_back
from tg4mm.fit.motion.observations import Observations, PosedFrames
from tg4mm.fit.motion.split_half import wiener_shrink
from tg4mm.fit.motion.temporal import TemporalModel
from tg4mm.fit.motion.temporal.synchronous import Synchronous
from tg4mm.fit.rasterize.buffers import Buffers
from tg4mm.fit.space.plane import plane_gaussians, solve_colours

# pixels, rms: what moves by less is read as it is, what moves by more is wholly put back. Far below what is linear
_LEFT, _PUT_BACK = 0.1, 0.3
_FALL = 0.05  # of what putting back has saved: what saves less is not worth another iteration
_NEAREST = 8  # Gaussians that one of the new scene takes its motion from


@dataclass(frozen=True)
class LinearSolution:
    """Folds' fields of a model's functions of time, and what they were found with."""

    model: TemporalModel
    hyper: Hyperparameters
    folds: np.ndarray  # [P, R, N, 6]
    gradients: np.ndarray  # [R, 4N, 3]

    @property
    def fields(self) -> np.ndarray:
        """[R, N, 6]: what the folds agree on."""
        return wiener_shrink(self.folds)[0]

    @property
    def vibration(self) -> np.ndarray:
        """[R, N, 6]: of `fields` the vibrations that were known before, which are put back; 0 of what else moves."""
        fields = self.fields.copy()
        fields[self.model.targets.n_known :] = 0
        return fields

    @property
    def basis(self) -> np.ndarray:
        """[R, T]: the functions of time."""
        return self.model.targets.basis[self.model.fitted]


@dataclass(frozen=True)
class _PutBack:
    """A model of pictures put back, and by what: fields [K, N, 6] of its first K functions of time."""

    model: TemporalModel
    fields: np.ndarray

    @property
    def left(self) -> float:
        """How much the pictures differ from each other: squares summed over them and over pixels."""
        targets, total = self.model.targets, 0.0
        for image in targets.images[0]:
            total += float(np.einsum("hwc,hwc->", image, image, dtype=np.float64)) / 3
            release(targets.images)
        return total + float(targets.residual_energy.sum(dtype=np.float64))

    def whole(self) -> TemporalModel:
        """The model whose target images hold the motion put back, too; the strongest function of time first."""
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


def iterated(
    first: LinearSolution,
    solve: Callable[[TemporalModel, Checkpoint], LinearSolution],
    checkpoint: Checkpoint,
) -> tuple[LinearSolution, int]:
    """The solution for a flat capture after iterations, `config.gauss_newton` at most, and how many counted.

    solve: hyperparameters and the linear fit of a model.
    """
    observations, solutions = first.model.observations, [first]
    lefts = [_PutBack(first.model, np.zeros(0)).left]
    for k in range(first.model.config.gauss_newton):
        named = suffixed(checkpoint, f"whole_pixels_{k}")
        there = _put_back(solutions[-1], observations, named)
        lefts.append(there.left)
        if lefts[-1] >= lefts[-2]:
            solutions = solutions[: max(k, 1)]
            break
        if k and lefts[-2] - lefts[-1] < _FALL * (lefts[0] - lefts[-1]):
            break
        found = solve(there.whole(), named)
        if not found.folds.shape[1]:
            break
        solutions.append(found)
    return solutions[-1], len(solutions) - 1


def _put_back(last: LinearSolution, observations: Observations, checkpoint: Checkpoint) -> _PutBack:
    """Pictures put back by the last solution, and a scene at rest that shows their mean."""
    model, frames = last.model, observations.frames[0]
    gaussians, basis = model.gaussians, last.basis[: last.model.targets.n_known]
    fields = _large(last.vibration[: len(basis)], frames)

    def displaced(gaussians: Gaussians, fields: np.ndarray) -> Observations:
        view = view_jacobian(gaussians, frames, observations.size)
        flow = np.ascontiguousarray(optical_flow(view, fields, Buffers())[..., :2])
        pictures = put_back(observations.pictures, frames, flow, basis)
        return replace(observations, pictures=pictures, courses=basis)

    def sharper() -> Arrays:
        mean = mean_pictures(displaced(gaussians, fields))[0]
        scene = plane_gaussians(mean, frames.K, frames.viewmat, len(gaussians))
        return arrays_of(solve_colours(scene, mean, frames.viewmat, frames.K).detach())

    if not observations.is_part:
        scene = gaussians_of(checkpoint("scene", sharper))
        fields = _interpolated(gaussians.means.numpy(), fields, scene.means.numpy())
        gaussians = scene
    # what was found to be no motion is taken out again
    nuisance = {0: "none", 1: "exposure"}.get(len(model.figures["nuisance"]), "all")
    config = replace(model.config, nuisance=nuisance)
    again = Synchronous.of(gaussians, displaced(gaussians, fields), config, model.problem.device, checkpoint)
    n = again.targets.n_known
    own = np.tensordot(again.targets.basis[:n] @ basis.T, fields, 1)
    return _PutBack(again, np.ascontiguousarray(own, np.float32))


def _large(fields: np.ndarray, frames: PosedFrames) -> np.ndarray:
    """[R, N, 6]: the fields, and 0 of Gaussians that hardly move."""
    across = fields[..., :3] @ frames.viewmat[:2, :3].T * np.diag(frames.K)[:2]  # at distance 1
    moved = np.sqrt((across.astype(np.float64) ** 2).sum((0, 2)) / len(frames.rows))
    return np.asarray(fields * np.clip((moved - _LEFT) / (_PUT_BACK - _LEFT), 0, 1)[:, None], np.float32)


def _interpolated(means: np.ndarray, fields: np.ndarray, at: np.ndarray) -> np.ndarray:
    """[R, M, 6]: fields [R, N, 6] of Gaussians at `means` [N, 3] at other places [M, 3], by distance."""
    distance, nearest = cKDTree(means).query(at, k=min(_NEAREST, len(means)))
    weights = 1 / (distance + 1e-9) ** 2
    weights /= weights.sum(1, keepdims=True)
    return np.asarray(np.einsum("rmkd,mk->rmd", fields[:, nearest], weights), np.float32)
