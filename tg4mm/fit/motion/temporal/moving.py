"""A camera that moves all the time: every frame is a view with its own pose, Jacobian and nuisance.

The scene at rest is first refined on all frames: in turn each frame's pose and exposure are corrected, by least
squares of its residual on the nuisance columns, and the Gaussians are fitted to all frames. The residual of a frame
is then motion, noise, and what the scene at rest still gets wrong. The last changes slowly with the
viewpoint. So the functions of time that are fitted hold, besides the sinusoids, a constant and slow polynomials, whose
fields are let go.

Motion that looks like the camera's own, of the whole picture as one, cannot be told from it: of all motions that
explain the frames, the one is taken in which most of the scene stands still.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from tg4mm.core.errors import RunError
from tg4mm.core.memory import mapped_zeros, release
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, arrays_of, gaussians_of
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.hyperparameters import Hyperparameters
from tg4mm.fit.motion.jacobian.view import VIEW_BYTES, blend_sum, view_jacobian
from tg4mm.fit.motion.nuisance.projection import POSE, Nuisance, Projection, with_still_background
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import Observations, PosedFrames, whole_pictures
from tg4mm.fit.motion.refine import refine_at_rest
from tg4mm.fit.motion.sinusoids import polynomials, sinusoids
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import folds_of
from tg4mm.fit.motion.temporal.frequencies import Frequencies
from tg4mm.fit.motion.temporal.regions import RegionSeries, labels_of, moving_camera_series
from tg4mm.fit.motion.temporal.steady import Steady, frequencies_of, frequency_figures, no_targets

_ALTERNATIONS = 3  # between poses and the scene at rest, at most
_STILL_PX = 0.05  # rms correction of the poses below which another brings nothing
_POSE_STEPS = 2
_ROBUST = 3.0  # robust deviations: residuals beyond count less
_SLOW_BELOW = 0.5  # of the lowest frequency: slow functions reach up to it
_THINNED = 3  # every third frame is enough to choose the smoothness weight
# Of the first fit, times the iterations of fixed cameras: with the camera's pose projected out, what moves against the
# background is found late.
_MORE_ITERATIONS = 2
_STILL_SHARE = (
    0.2  # of what is seen, that moves: beyond it which part stands still is not told (docs/captures.md)
)
_MOVES, _LARGEST = 0.25, 0.99  # of the largest amplitude; the quantile that is called the largest
_LEAST_POWER = 1.5  # of a frequency, times the noise's
# What the scene at rest gets wrong changes with the viewpoint, and so in time: up to six times along the path of a
# camera that goes around a still scene, with eight times the noise's power.
_PERIODS = 8.0
_JUDGED = 10
_ALL = np.ones(12, bool)


@dataclass(frozen=True)
class MovingCamera(Steady):
    """`TemporalModel` of one camera that moves."""

    if_halves_disagree: ClassVar[str] = "a fixed camera and a sweep (docs/capture-guide.md, tripod) tell"
    min_reliability: ClassVar[float] = 0.7  # below it is also what the scene at rest gets wrong

    @staticmethod
    def of(
        gaussians: Gaussians,
        observations: Observations,
        config: MotionConfig,
        device: str,
        checkpoint: Checkpoint,
    ) -> MovingCamera:
        """The scene and poses refined on all frames, the residuals of these, and frequencies in them."""
        gaussians, frames, refined = _refine_scene_and_poses(
            gaussians, observations, config, device, checkpoint
        )
        observations = replace(observations, frames=frames)
        problem, residuals = _residual_problem(gaussians, observations, config, device)
        lowest_hz = _PERIODS / observations.duration_s
        frequencies = frequencies_of(
            observations, [_series(problem, residuals, observations, checkpoint)], _LEAST_POWER, lowest_hz
        )
        figures = {**refined, "nuisance": ["exposure", "pose"], **frequency_figures(frequencies)}
        notes = [
            "the camera moves: a motion of the whole scene as one cannot be told from its own, nor one below "
            f"{lowest_hz:.2g} Hz (eight periods in the record) from what changes with the viewpoint",
            f"what moves by less than {_MOVES:g} of the largest at its frequency is held still, so that it tells "
            "the poses; motion towards the camera comes out too small",
        ]
        targets = no_targets(observations)
        if len(frequencies.hz):
            functions = functions_of(observations, frequencies)
            targets = replace(targets, basis=functions, images=residuals)
            mixing = [row[None].astype(np.float32) for row in functions.T]
            problem = problem.changed(mixing=mixing)
        folds = folds_of(len(frames), observations.size, True, config.split_half)
        scale = float(np.sqrt(2 / len(frames)))
        return MovingCamera(
            gaussians, observations, problem, targets, folds, config, figures, notes,
            np.arange(targets.images.shape[1]), frequencies, scale,
        )  # fmt: skip

    def strongest(self) -> tuple[np.ndarray, Problem, Sequence[Fold]]:
        """All functions together, in some of the frames."""
        thinned = [replace(fold, views=fold.views[::_THINNED]) for fold in self.folds]
        return self.targets.images, self.problem, thinned

    def completed(self, hyper: Hyperparameters, checkpoint: Checkpoint) -> MovingCamera:
        return self

    def fix_gauge(self, folds: np.ndarray) -> np.ndarray:
        """With the background still, each frequency by itself."""
        means, seen = self.gaussians.means.numpy(), self._seen_weights
        pairs = [
            with_still_background(fields[k : k + 2], means, seen)
            for fields in folds
            for k in range(0, len(fields), 2)
        ]
        return np.concatenate(pairs).reshape(folds.shape)

    @property
    def first_iterations(self) -> int:
        return _MORE_ITERATIONS * self.config.iterations

    def support(self, folds: np.ndarray) -> np.ndarray:
        """What moves by a quarter of the largest amplitude or more, for each frequency; slow functions where any does.

        With the pose projected out the first fit spreads motion over what stands still. Where that is held still,
        the poses are told by it, and the amplitude comes out.
        """
        fields = self.fix_gauge(folds[:, : 2 * len(self.hz)]).mean(0)[..., :3]
        amplitudes = np.sqrt((fields**2).sum(2).reshape(len(self.hz), 2, -1).sum(1))
        largest = np.quantile(amplitudes[:, self._seen_weights > 0], _LARGEST, axis=1, keepdims=True)
        moves = amplitudes > _MOVES * largest
        slow = np.tile(moves.any(0), (folds.shape[1] - 2 * len(self.hz), 1))
        return np.concatenate([np.repeat(moves, 2, 0), slow]).astype(np.float32)

    def unclear(self, fields: np.ndarray) -> list[str]:
        """Which part of fields [2 K, N, 6] stands still, where most of the picture moves."""
        amplitudes = np.sqrt((fields[0::2, :, :3] ** 2 + fields[1::2, :, :3] ** 2).sum(-1))
        seen = self._seen_weights
        largest = np.quantile(amplitudes[:, seen > 0], _LARGEST, axis=1, keepdims=True)
        share = float(((amplitudes > _MOVES * largest) * seen).sum(1).max() / seen.sum())
        if share <= _STILL_SHARE:
            return []
        return [
            f"{share:.0%} of what is seen moves: where more than {_STILL_SHARE:.0%} do, or most of the picture, its "
            "motion cannot be told from the camera's own, and what is shown may be what stands still, moved back; "
            "a fixed camera and a sweep tell (docs/capture-guide.md, tripod)"
        ]

    @cached_property
    def _seen_weights(self) -> np.ndarray:
        """[N]: how much is seen of each Gaussian, in some frames."""
        views = self.problem.views
        ones = np.ones((*self.problem.size[::-1], 3), np.float32)
        total = np.zeros(self.problem.n_gaussians)
        for view in views[:: max(len(views) // _JUDGED, 1)]:
            total += blend_sum(view, ones)[:, 0]
            view.release()
        return total


def functions_of(observations: Observations, frequencies: Frequencies) -> np.ndarray:
    """[R, F]: cosines and sines, then a constant and slow polynomials; the squares of each sum to 1."""
    times = np.array([f.times_s[0] for f in observations.frames])
    degree = max(round(2 * _SLOW_BELOW * float(frequencies.hz.min()) * float(np.ptp(times)) / 2), 1)
    slow = polynomials(times, min(degree, 4)).T
    slow *= 1 / np.sqrt((slow**2).sum(1, keepdims=True))
    return np.concatenate([np.sqrt(2 / len(times)) * sinusoids(times, frequencies.hz), slow])


def _residual_problem(
    gaussians: Gaussians, observations: Observations, config: MotionConfig, device: str
) -> tuple[Problem, np.ndarray]:
    """The problem, and the residual of every frame [F, 1, H, W, 3] with exposure and pose projected out.

    All pixels count alike: a residual holds the motion that is to be found, so that weights by its size would leave the
    fit what does not move.
    """
    views, projections, means = [], [], gaussians.means.numpy()
    n, (width, height) = len(observations.frames), observations.size
    residuals = mapped_zeros((n, 1, height, width, 3))
    with progress("residuals", n, "frames") as update:
        for k, (frame, picture) in enumerate(
            zip(observations.frames, pictures_of(observations), strict=True)
        ):
            view = view_jacobian(gaussians, frame, observations.size)
            is_large = n * view.nbytes > VIEW_BYTES
            view = view.stored() if is_large else view
            shown = view.over_white
            nuisance = Nuisance(view, frame, means, _ALL)
            projection = Projection.of(nuisance, shown, None, is_large, keeps=False)
            model = ObservationModel(frame, view, projection)
            residuals[k] = model.without_nuisance((picture - shown)[None])
            model.release()
            views.append(view)
            projections.append(projection)
            update(k + 1)
    return replace(Problem.of(views, gaussians, config, device), projections=projections), residuals


def _series(
    problem: Problem, residuals: np.ndarray, observations: Observations, checkpoint: Checkpoint
) -> RegionSeries:
    times = np.array([f.times_s[0] for f in observations.frames])

    def compute() -> Arrays:
        labels = labels_of(problem.aggregates)
        each = zip(observations.frames, problem.views, problem.projections or (), strict=True)
        models = [ObservationModel(*own) for own in each]
        return moving_camera_series(models, (np.array(own[0]) for own in residuals), labels).arrays()

    return RegionSeries.restored(times, checkpoint("regions", compute))


def _refine_scene_and_poses(
    gaussians: Gaussians,
    observations: Observations,
    config: MotionConfig,
    device: str,
    checkpoint: Checkpoint,
) -> tuple[Gaussians, list[PosedFrames], dict[str, Any]]:
    """Gaussians and poses refined in turn on all frames, and how far poses went (pixels)."""
    frames, moved = observations.frames, []
    for k in range(_ALTERNATIONS):

        def compute(
            frames: list[PosedFrames] = frames, gaussians: Gaussians = gaussians, k: int = k
        ) -> Arrays:
            width, height = observations.size
            pictures = mapped_zeros((len(frames), height, width, 3))
            new, _, pixels = corrected_poses(gaussians, replace(observations, frames=frames), k, pictures)
            iterations = int(np.clip(4 * len(frames), 300, 1500))
            shown = refine_at_rest(gaussians, new, pictures, iterations, config.seed + k, device)
            poses = {"viewmats": np.stack([f.viewmat for f in new]), "pixels": np.array(pixels)}
            return arrays_of(shown) | poses

        kept = checkpoint(f"scene_{k}", compute)
        gaussians = gaussians_of(kept)
        frames = [replace(f, viewmat=v) for f, v in zip(frames, kept["viewmats"], strict=True)]
        moved.append(round(float(kept["pixels"]), 4))
        if moved[-1] < _STILL_PX:
            break
    return gaussians, frames, {"pose_corrections_px": moved}


def pictures_of(observations: Observations) -> Iterator[np.ndarray]:
    """[H, W, 3] float32 of every frame, over white."""
    for frame in observations.frames:
        yield next(whole_pictures(observations, frame.rows))[0]


def corrected_poses(
    gaussians: Gaussians, observations: Observations, k: int, pictures: np.ndarray | None = None
) -> tuple[list[PosedFrames], np.ndarray, float]:
    """Frames with corrected poses, gain and offset [F, 6] of each, and the rms correction in pixels.

    `pictures` [F, H, W, 3], where they are given, become those of the frames with exposure taken out.
    """
    out, exposures, squares = [], [], []
    means = gaussians.means.numpy()
    label = f"poses, {k + 1} of {_ALTERNATIONS}"
    with progress(label, len(observations.frames), "frames") as update:
        for i, (frame, picture) in enumerate(
            zip(observations.frames, pictures_of(observations), strict=True)
        ):
            first = frame
            for _ in range(_POSE_STEPS):
                view = view_jacobian(gaussians, frame, observations.size)
                shown = view.over_white
                nuisance = Nuisance(view, frame, means, _ALL)
                n = _coefficients(nuisance, shown, picture - shown)
                frame = replace(frame, viewmat=_corrected(frame.viewmat, n[POSE]))
            if not np.isfinite(frame.viewmat).all():
                raise RunError(
                    f"the pose of frame {i} cannot be refined: what it shows is not the scene at rest"
                )
            out.append(frame)
            exposures.append(n[:6].astype(np.float32))
            if pictures is not None:
                pictures[i] = (picture - exposures[i][3:]) / (1 + exposures[i][:3])
                release(pictures)
            squares.append(_apart(first, frame, means, gaussians.opacities.numpy()))
            update(i + 1)
    return out, np.array(exposures), float(np.sqrt(np.mean(squares)))


def _coefficients(nuisance: Nuisance, shown: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """[12] of one frame: least squares, residuals beyond three robust deviations counting less."""
    columns = nuisance.columns(shown).reshape(12, -1)
    flat, weights = residual.reshape(-1), np.ones(residual.size, np.float32)
    scale = np.sqrt((columns.astype(np.float64) ** 2).sum(1)) + 1e-12
    n = np.zeros(12)
    for _ in range(3):
        weighted = columns * weights
        gram = (weighted @ columns.T).astype(np.float64) / np.outer(scale, scale)
        side = (weighted @ flat).astype(np.float64) / scale
        n = np.linalg.solve(gram + 1e-6 * np.eye(12), side) / scale
        error = flat - n.astype(np.float32) @ columns
        spread = 1.4826 * float(np.median(np.abs(error))) + 1e-6
        weights = 1 / (1 + (error / (_ROBUST * spread)) ** 2)
    return n


def _corrected(viewmat: np.ndarray, n: np.ndarray) -> np.ndarray:
    """The pose that shows what the scene would show if it moved rigidly by n about the camera (`rigid_fields`)."""
    out = viewmat.astype(np.float64).copy()
    rotation = Rotation.from_rotvec(n[:3]).as_matrix()  # camera axes
    out[:3] = rotation @ out[:3]
    out[:3, 3] += n[3:]
    return out.astype(np.float32)


def _apart(a: PosedFrames, b: PosedFrames, means: np.ndarray, opacities: np.ndarray) -> float:
    """Mean squared distance in pixels between what two poses make of the Gaussians before the camera."""
    pixels = []
    for frame in (a, b):
        x = means @ frame.viewmat[:3, :3].T + frame.viewmat[:3, 3]
        pixels.append(x[:, :2] / np.maximum(x[:, 2:], 1e-6) * np.diag(frame.K)[:2])
    seen = (x[:, 2] > 1e-3) & (np.abs(pixels[0]) < 2 * frame.K[:2, 2]).all(1) & (opacities > 0.1)
    return float(((pixels[0] - pixels[1])[seen] ** 2).sum(1).mean()) if seen.any() else 0.0
