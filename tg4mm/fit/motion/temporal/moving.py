"""A camera that moves all the time: every frame is a view with its own pose, Jacobian and nuisance.

The scene at rest is first refined on all frames: in turn, each frame's pose and exposure are corrected by least squares
of its residual on the nuisance columns, and the Gaussians are fitted to all frames. The residual of a frame is then
motion, noise, and errors of the scene at rest. These errors change slowly with the viewpoint. So besides the sinusoids,
a constant and slow polynomials are fitted, and their fields discarded.

Motion common to the complete picture cannot be distinguished from the camera's: of all motions that explain the frames,
the one is chosen in which most of the scene is at rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from tg4mm.core.memory import mapped_zeros
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.hyperparameters import Hyperparameters
from tg4mm.fit.motion.jacobian.view import VIEW_BYTES, blend_sum, view_jacobian
from tg4mm.fit.motion.nuisance.poses import (
    CameraPath,
    FieldReading,
    left_of,
    pictures_of,
    refine_scene_and_poses,
)
from tg4mm.fit.motion.nuisance.projection import POSE, Nuisance, Projection, with_still_background
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.spectrum import polynomials, sinusoids
from tg4mm.fit.motion.split_half import folds_of
from tg4mm.fit.motion.temporal.sinusoidal import (
    Frequencies,
    RegionSeries,
    SinusoidalModel,
    frequencies_of,
    frequency_figures,
    moving_camera_series,
    no_targets,
)

_SLOW_BELOW = 0.5  # of the lowest frequency: slow functions reach up to it
_THINNED = 3  # every third frame is enough to choose the smoothness weight
# Of each fit, times the iterations of fixed cameras: with the camera's pose projected out, what moves against the
# background converges late. Stopped at once as many, the fits within a support lost a third of the amplitude.
_MORE_ITERATIONS = 2
_MOVES, _LARGEST = 0.25, 0.99  # of the largest amplitude; the quantile that is called the largest
_LEAST_POWER = 1.5  # of a frequency, times the noise's
# What the scene at rest gets wrong changes with the viewpoint, and so in time: up to six times along the path of a
# camera that goes around a still scene, with eight times the noise's power.
_PERIODS = 8.0
_JUDGED = 10
_ALL = np.ones(12, bool)


@dataclass(frozen=True)
class MovingCamera(SinusoidalModel):
    """`TemporalModel` of one camera that moves."""

    if_halves_disagree: ClassVar[str] = "use a fixed camera and a sweep (docs/capture-guide.md, tripod)"
    path: CameraPath
    ambiguity: np.ndarray | None = None  # [N] squares of the fields' error; None: no field was read
    min_reliability: ClassVar[float] = 0.7  # below it is also what the scene at rest gets wrong

    @staticmethod
    def of(
        gaussians: Gaussians,
        observations: Observations,
        config: MotionConfig,
        device: str,
        checkpoint: Checkpoint,
    ) -> "MovingCamera":
        """The scene and poses refined on all frames, the residuals of these, and frequencies in them."""
        config = replace(config, iterations=_MORE_ITERATIONS * config.iterations)
        gaussians, frames, refined = refine_scene_and_poses(
            gaussians, observations, config, device, checkpoint
        )
        observations = replace(observations, frames=frames)
        problem, residuals, left = _residual_problem(gaussians, observations, config, device)
        lowest_hz = _PERIODS / observations.duration_s
        shifts = _series(problem, residuals, observations, checkpoint)
        frequencies, of_band = frequencies_of(observations, [shifts], _LEAST_POWER, lowest_hz, config)
        figures = {**refined, "nuisance": ["exposure", "pose"], **frequency_figures(frequencies), **of_band}
        notes = [
            "common motion of the complete scene, which looks like motion of the camera; motion below "
            f"{lowest_hz:.2g} Hz (eight periods in the record), which looks like a change of viewpoint",
            f"motion below {_MOVES:g} of the largest at its frequency, which is set to zero to determine "
            "the poses; motion towards the camera is underestimated",
        ]
        if (slow := frequencies.hz[frequencies.hz < lowest_hz]).size:  # of a band that was asked for
            figures["lower_bound_hz"] = [round(float(f), 4) for f in slow]
            notes.append(
                f"amplitudes at {', '.join(f'{f:.4g}' for f in slow)} Hz: with fewer than eight periods the "
                "scene at rest absorbs slow changes, and amplitudes are lower bounds; use a fixed camera"
            )
        targets = no_targets(observations)
        if len(frequencies.hz):
            functions = functions_of(observations, frequencies)
            targets = replace(targets, basis=functions, images=residuals)
            mixing = [row[None].astype(np.float32) for row in functions.T]
            problem = problem.changed(mixing=mixing)
        folds = folds_of(len(frames), observations.size, True, config.split_half)
        scale = float(np.sqrt(2 / len(frames)))
        viewmats, times = np.stack([f.viewmat for f in frames]), np.concatenate([f.times_s for f in frames])
        path = CameraPath.of(times, viewmats, left, gaussians.means.numpy(), _seen_weights(problem))
        return MovingCamera(
            gaussians, observations, problem, targets, folds, config, figures, notes,
            np.arange(targets.images.shape[1]), frequencies, scale, path,
        )  # fmt: skip

    def strongest(self) -> tuple[np.ndarray, Problem, Sequence[Fold]]:
        """Return all functions together, in some of the frames."""
        thinned = [replace(fold, views=fold.views[::_THINNED]) for fold in self.folds]
        return self.targets.images, self.problem, thinned

    def completed(self, hyper: Hyperparameters, checkpoint: Checkpoint) -> "MovingCamera":
        return self

    def fix_gauge(self, folds: np.ndarray) -> np.ndarray:
        """Return fields in which the background is at rest, for each frequency."""
        means, seen = self.gaussians.means.numpy(), self.path.seen
        pairs = [
            with_still_background(fields[k : k + 2], means, seen)
            for fields in folds
            for k in range(0, len(fields), 2)
        ]
        return np.concatenate(pairs).reshape(folds.shape)

    def support(self, folds: np.ndarray) -> np.ndarray:
        """Return what moves by a quarter of the largest amplitude or more, for each frequency; any for slow functions.

        With the pose projected out the first fit spreads motion over what stands still. Where that is held still,
        it determines the poses, and the amplitude is correct.
        """
        moves = self._moves(self.fix_gauge(folds[:, : 2 * len(self.hz)]).mean(0))
        slow = np.tile(moves.any(0), (folds.shape[1] - 2 * len(self.hz), 1))
        return np.concatenate([np.repeat(moves, 2, 0), slow]).astype(np.float32)

    def _moves(self, fields: np.ndarray) -> np.ndarray:
        """Return [K, N] bool: by a quarter of the largest amplitude or more, of fields [2K, N, 6]."""
        squares = (fields[..., :3] ** 2).sum(2)
        amplitudes = np.sqrt(squares[0::2] + squares[1::2])
        largest = np.quantile(amplitudes[:, self.path.seen > 0], _LARGEST, axis=1, keepdims=True)
        return np.asarray(amplitudes > _MOVES * largest)

    def settled(self, folds: np.ndarray) -> "tuple[MovingCamera, np.ndarray]":
        """Keep the frequencies on which two folds agree and for which the camera's path shows what is at rest."""
        model, folds = super().settled(folds)
        readings = model._readings(folds.mean(0))
        if not readings:
            return model, folds
        folds, is_determined = folds.copy(), np.array([r.is_determined for r in readings])
        for k, reading in enumerate(readings):
            if reading.rigid is not None:
                folds[:, 2 * k] -= reading.rigid.real
                folds[:, 2 * k + 1] -= reading.rigid.imag
        figures: dict[str, Any] = {
            "moving_share": [round(r.moving_share, 3) for r in readings],
            "other_reading": [round(r.doubt, 4) for r in readings],
        }
        notes = [*model.notes]
        if not is_determined.all():
            figures["undetermined_hz"] = [round(float(f), 4) for f in model.hz[~is_determined]]
            notes += _undetermined_notes(model.hz, is_determined, model.is_asked)
        is_determined = is_determined | model.is_asked
        kept = (r.squares for r, stays in zip(readings, is_determined, strict=True) if stays)
        ambiguity = sum(kept, np.zeros(len(model.gaussians)))
        model = replace(model, ambiguity=ambiguity, figures=model.figures | figures, notes=notes)
        return model._with(is_determined), folds[:, np.repeat(is_determined, 2)]

    def ground_squares(self) -> np.ndarray | None:
        return self.ambiguity

    def _readings(self, fields: np.ndarray) -> list[FieldReading]:
        """Read the camera path for every frequency's fields [2K, N, 6]."""
        if not len(fields):
            return []
        functions = np.sqrt(2 / len(self.path.times_s)) * sinusoids(self.path.times_s, self.hz)
        path = self.path.without(fields, functions, self.problem.projections or ())
        moves, pairs = self._moves(fields), fields[0::2, :, :3] + 1j * fields[1::2, :, :3]
        return [
            self.path.reading(path, pairs[k], moves[k], float(hz), np.delete(self.hz, k), self.scale)
            for k, hz in enumerate(self.hz)
        ]


def _undetermined_notes(hz: np.ndarray, is_determined: np.ndarray, is_asked: np.ndarray) -> list[str]:
    """Return notes on frequencies [K] whose motion may be the camera's; those in the requested band stay."""
    out = []
    for some, what in (
        (~is_determined & ~is_asked, ", which the run therefore leaves out"),
        (~is_determined & is_asked, " is a guess, kept because the band was given"),
    ):
        if some.any():
            named = ", ".join(f"{f:.4g}" for f in hz[some])
            out.append(
                f"the motion at {named} Hz{what}: neither the moving share of the picture nor the camera's path "
                "separates it from camera motion; use a fixed camera and a sweep "
                "(docs/capture-guide.md, tripod)"
            )
    return out


def _seen_weights(problem: Problem) -> np.ndarray:
    """Return [N]: how much is seen of each Gaussian, in some frames."""
    ones = np.ones((*problem.size[::-1], 3), np.float32)
    total = np.zeros(problem.n_gaussians)
    for view in problem.views[:: max(len(problem.views) // _JUDGED, 1)]:
        total += blend_sum(view, ones)[:, 0]
        view.release()
    return total


def functions_of(observations: Observations, frequencies: Frequencies) -> np.ndarray:
    """Return [R, F]: cosines and sines, then a constant and slow polynomials; the squares of each sum to 1."""
    times = np.array([f.times_s[0] for f in observations.frames])
    degree = max(round(2 * _SLOW_BELOW * float(frequencies.hz.min()) * float(np.ptp(times)) / 2), 1)
    slow = polynomials(times, min(degree, 4)).T
    slow *= 1 / np.sqrt((slow**2).sum(1, keepdims=True))
    return np.concatenate([np.sqrt(2 / len(times)) * sinusoids(times, frequencies.hz), slow])


def _residual_problem(
    gaussians: Gaussians, observations: Observations, config: MotionConfig, device: str
) -> tuple[Problem, np.ndarray, np.ndarray]:
    """The problem, the residual of every frame [F, 1, H, W, 3] without exposure and pose, and [F, 6] of the pose in it.

    All pixels count alike: a residual holds the motion that is to be found, so that weights by its size would leave the
    fit what does not move.
    """
    views, projections, means = [], [], gaussians.means.numpy()
    n, (width, height) = len(observations.frames), observations.size
    residuals, left = mapped_zeros((n, 1, height, width, 3)), np.zeros((n, 6))
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
            change = left_of(picture, shown)
            residuals[k] = model.without_nuisance(change[None])
            left[k] = projection.coefficients(change)[POSE]
            model.release()
            views.append(view)
            projections.append(projection)
            update(k + 1)
    return replace(Problem.of(views, gaussians, config, device), projections=projections), residuals, left


def _series(
    problem: Problem, residuals: np.ndarray, observations: Observations, checkpoint: Checkpoint
) -> RegionSeries:
    times = np.array([f.times_s[0] for f in observations.frames])

    def compute() -> Arrays:
        labels = problem.aggregates.labels
        each = zip(observations.frames, problem.views, problem.projections or (), strict=True)
        models = [ObservationModel(*arguments) for arguments in each]
        return moving_camera_series(
            models, (np.array(arguments[0]) for arguments in residuals), labels
        ).arrays()

    return RegionSeries(times, **checkpoint(Step.regions, compute))
