"""A camera that moves all the time: every frame is a view with its own pose, Jacobian and nuisance.

The scene at rest is first made to agree with all frames: by turns each frame's pose and exposure are corrected, by
least squares of what is left of it on the nuisance columns, and the Gaussians are refined on all frames. What is then
left of a frame is motion, noise, and what the scene at rest still gets wrong. The last changes slowly with the
viewpoint. So the functions of time that are fitted hold, besides the sinusoids, a constant and slow polynomials, whose
fields are let go.

Motion that looks like the camera's own, of the whole picture as one, cannot be told from it: of all motions that
explain the frames, the one is taken in which most of the scene stands still (`gauge.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from scipy.spatial.transform import Rotation

from tg4mm.capture.pictures import over_white
from tg4mm.errors import RunError
from tg4mm.gaussians import Gaussians
from tg4mm.motion.checkpoints import Arrays, Parts
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.gauge import with_still_background
from tg4mm.motion.hyperparameters import DEFAULT, chosen_weight
from tg4mm.motion.jacobian.colour import blend_sum
from tg4mm.motion.jacobian.pixels import pixels_moved
from tg4mm.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.motion.limits import frequency_notes
from tg4mm.motion.nuisance import POSE, Nuisance, Projection
from tg4mm.motion.observations import Observations, PosedFrames
from tg4mm.motion.problem import Problem
from tg4mm.motion.refine import MovedPictures, refine_rest_scene
from tg4mm.motion.regions import RegionSeries, labels_of, moving_camera_series
from tg4mm.motion.result import MotionFit
from tg4mm.motion.solver.operator import Fold
from tg4mm.motion.solver.pcg import pcg
from tg4mm.motion.split_half import folds_of, reliability, wiener_shrink
from tg4mm.motion.steady import frequencies_of, motion_of, without_motion
from tg4mm.motion.temporal import sinusoids
from tg4mm.motion.uncertainty import Found, of_halves
from tg4mm.progress import progress

_ROUNDS = 3  # of poses and refining, at most
_STILL_PX = 0.05  # rms correction of the poses below which another round brings nothing
_POSE_STEPS = 2
_ROBUST = 3.0  # robust deviations: residuals beyond count less
_SLOW_BELOW = 0.5  # of the lowest frequency: slow functions reach up to it
_THINNED = 3  # every third frame is enough to choose the smoothness weight
_MOST_ITERATIONS = 18  # of conjugate gradients
_LEAST_POWER = 1.5  # of a frequency, times the noise's
# What the scene at rest gets wrong changes with the viewpoint, and so in time: up to six times along the path of a
# camera that goes around a still scene, with eight times the noise's power.
_PERIODS = 8.0
_AGREED = 0.7  # reliability below which a frequency is noise, or what the scene at rest gets wrong
_JUDGED = 10
_ALL = np.ones(12, bool)


@dataclass(frozen=True)
class _Frame:
    """One frame as the fit sees it."""

    frame: PosedFrames
    view: ViewJacobian
    left: np.ndarray  # [H, W, 3] what is left of it, exposure taken out
    weights: np.ndarray  # [H, W]


def fit_moving_camera(
    gaussians: Gaussians, observations: Observations, config: MotionConfig, device: str, parts: Parts
) -> MotionFit:
    """`fit_motion` of a camera that moves."""
    gaussians, frames, refined = _agreed_scene(gaussians, observations, config, device, parts)
    observations = replace(observations, frames=frames)
    seen, projections = _seen(gaussians, observations)
    problem = Problem.of([s.view for s in seen], gaussians, config, device)
    series = _series(seen, projections, problem, parts)
    lowest_hz = _PERIODS / observations.duration_s
    found = frequencies_of(observations, [series], _LEAST_POWER, lowest_hz)
    figures: dict[str, Any] = {
        **refined,
        "views": len(seen),
        "iterations": config.iterations,
        "nuisance": ["exposure", "pose"],
        "frequencies_hz": [round(float(f), 4) for f in found.hz],
        "frequency_deviation_hz": [round(float(f), 5) for f in found.deviation_hz],
    }
    notes = [
        "the camera moves: a motion of the whole scene as one cannot be told from its own, nor one below "
        f"{lowest_hz:.2g} Hz (eight periods in the record) from what changes with the viewpoint"
    ]
    if not len(found.hz):
        return without_motion(gaussians, observations, figures, notes)
    notes += frequency_notes(found.hz, observations)
    fit = _MovingFit(problem, seen, projections, observations, found.hz, config, parts)
    folds, weight = fit.folds()
    shapes, gains = wiener_shrink(folds)
    is_agreed = _reliability_of_pairs(folds) >= _AGREED
    if not is_agreed.any():
        return without_motion(gaussians, observations, figures, notes)
    rows = np.repeat(is_agreed, 2)
    found, folds, shapes, gains = found.selected(is_agreed), folds[:, rows], shapes[rows], gains[rows]
    fit, figures["frequencies_hz"] = replace(fit, hz=found.hz), [round(float(f), 4) for f in found.hz]
    figures["frequency_deviation_hz"] = [round(float(f), 5) for f in found.deviation_hz]
    scale = fit.scale
    moved = pixels_moved(problem.views[:: max(len(seen) // 8, 1)], shapes[:2, :, :3] * np.float32(scale))
    figures |= {
        "smoothness_weight": weight,
        "reliability": [round(float(g), 4) for g in gains],
        "pixels_moved": float(np.hypot(*moved)),
        "n_frequencies": len(found.hz),
    }
    arrays: dict[str, np.ndarray] = {}
    if len(folds) == 2:
        uncertain = of_halves(fit.found(folds, shapes), observations.n_timesteps)
        arrays, figures, notes = uncertain.arrays, figures | uncertain.figures, [*notes, *uncertain.notes]
    return MotionFit(gaussians, motion_of(shapes, found.hz, scale, observations), arrays, figures, notes)


def _reliability_of_pairs(folds: np.ndarray) -> np.ndarray:
    """[K] of each frequency's sine and cosine together, of the fields [2, 2K, N, 6] of two halves; 1 of one fold."""
    if len(folds) == 1:
        return np.ones(folds.shape[1] // 2)
    a, b = (half[..., :3].reshape(half.shape[0] // 2, -1, 3) for half in folds)
    return reliability((a + b) / 2, a, b)


def pictures_of(observations: Observations) -> Iterator[np.ndarray]:
    """[H, W, 3] float32 of every frame, over white."""
    for frame in observations.frames:
        raw = observations.pictures.strips([int(frame.rows[0])])
        yield over_white(raw(slice(None)), observations.pictures.maximum)[0]


def _agreed_scene(
    gaussians: Gaussians, observations: Observations, config: MotionConfig, device: str, parts: Parts
) -> tuple[Gaussians, list[PosedFrames], dict[str, Any]]:
    """Gaussians and poses that agree with all frames, and how far poses went (pixels)."""
    frames, moved = observations.frames, []
    for k in range(_ROUNDS):

        def compute(
            frames: list[PosedFrames] = frames, gaussians: Gaussians = gaussians, k: int = k
        ) -> Arrays:
            new, exposures, pixels = corrected_poses(gaussians, replace(observations, frames=frames), k)
            shown = _refined(gaussians, replace(observations, frames=new), exposures, config.seed + k, device)
            out = {
                f"g.{n}": getattr(shown, n).numpy() for n in ("means", "quats", "scales", "opacities", "sh")
            }
            return out | {"viewmats": np.stack([f.viewmat for f in new]), "pixels": np.array(pixels)}

        kept = parts(f"scene_{k}", compute)
        gaussians = _gaussians(kept)
        frames = [replace(f, viewmat=v) for f, v in zip(frames, kept["viewmats"], strict=True)]
        moved.append(round(float(kept["pixels"]), 4))
        if moved[-1] < _STILL_PX:
            break
    return gaussians, frames, {"pose_corrections_px": moved}


def _gaussians(arrays: Arrays) -> Gaussians:
    import torch

    return Gaussians(
        **{k[2:]: torch.from_numpy(np.array(v)) for k, v in arrays.items() if k.startswith("g.")}
    )


def corrected_poses(
    gaussians: Gaussians, observations: Observations, k: int
) -> tuple[list[PosedFrames], np.ndarray, float]:
    """Frames with corrected poses, gain and offset [F, 6] of each, and the rms correction in pixels."""
    out, exposures, squares = [], [], []
    means = gaussians.means.numpy()
    label = f"poses, round {k + 1} of {_ROUNDS}"
    with progress(label, len(observations.frames), "frames") as update:
        for i, (frame, picture) in enumerate(
            zip(observations.frames, pictures_of(observations), strict=True)
        ):
            first = frame
            for _ in range(_POSE_STEPS):
                view = view_jacobian(gaussians, frame, observations.size)
                shown = at_rest(view)
                nuisance = Nuisance(view, frame, means, _ALL)
                n = _coefficients(nuisance, shown, picture - shown)
                frame = replace(frame, viewmat=_turned(frame.viewmat, n[POSE]))
            if not np.isfinite(frame.viewmat).all():
                raise RunError(
                    f"the pose of frame {i} cannot be refined: what it shows is not the scene at rest"
                )
            out.append(frame)
            exposures.append(n[:6])
            squares.append(_apart(first, frame, means, gaussians.opacities.numpy()))
            update(i + 1)
    return out, np.array(exposures, np.float32), float(np.sqrt(np.mean(squares)))


def at_rest(view: ViewJacobian) -> np.ndarray:
    return view.image[..., :3] + view.transmittance[..., None]


def _coefficients(nuisance: Nuisance, shown: np.ndarray, left: np.ndarray) -> np.ndarray:
    """[12] of one frame: least squares, residuals beyond three robust deviations counting less."""
    columns = nuisance.columns(shown).reshape(12, -1)
    flat, weights = left.reshape(-1), np.ones(left.size, np.float32)
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


def _turned(viewmat: np.ndarray, n: np.ndarray) -> np.ndarray:
    """The pose that shows what the scene would show if it moved rigidly by n about the camera (`rigid_fields`)."""
    out = viewmat.astype(np.float64).copy()
    turn = Rotation.from_rotvec(n[:3]).as_matrix()  # camera axes
    out[:3] = turn @ out[:3]
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


def _refined(
    gaussians: Gaussians, observations: Observations, exposures: np.ndarray, seed: int, device: str
) -> Gaussians:
    """The Gaussians refined on all frames, whose exposure is taken out."""
    width, height = observations.size
    pictures = np.empty((len(observations.frames), 1, height, width, 3), np.float32)
    for k, picture in enumerate(pictures_of(observations)):
        pictures[k, 0] = (picture - exposures[k, 3:]) / (1 + exposures[k, :3])
    motions = np.zeros((1, len(gaussians), 6), np.float32)
    seen = MovedPictures(observations.frames, pictures, motions, np.zeros(1, np.int64))
    iterations = int(np.clip(4 * len(observations.frames), 300, 1500))
    with progress("scene at rest, refined", iterations, "iterations") as update:
        return refine_rest_scene(gaussians, seen, iterations, seed, device, update)


def _seen(gaussians: Gaussians, observations: Observations) -> tuple[list[_Frame], list[Projection]]:
    """Every frame's view, what is left of it, and its nuisance projection."""
    means, out, projections = gaussians.means.numpy(), [], []
    with progress("views", len(observations.frames), "frames") as update:
        for k, (frame, picture) in enumerate(
            zip(observations.frames, pictures_of(observations), strict=True)
        ):
            view = view_jacobian(gaussians, frame, observations.size)
            shown = at_rest(view)
            left = picture - shown
            weights = robust_weights(left)
            nuisance = Nuisance(view, frame, means, _ALL)
            projection = Projection.of(nuisance, shown, weights)
            left = projection.out_of(left[None])[0]
            nuisance.__dict__.pop("pose", None)  # 25 bytes a pixel and frame, made again when it is asked for
            out.append(_Frame(frame, view, left, weights))
            projections.append(projection)
            update(k + 1)
    return out, projections


def robust_weights(left: np.ndarray) -> np.ndarray:
    """[H, W] float32: pixels where much is left (edges, occlusions) count less."""
    size = np.sqrt((left**2).mean(-1))
    spread = 1.4826 * float(np.median(size)) + 1e-6
    return np.asarray(1 / (1 + (size / (_ROBUST * spread)) ** 2), np.float32)


def _series(
    seen: Sequence[_Frame], projections: Sequence[Projection], problem: Problem, parts: Parts
) -> RegionSeries:
    times = np.array([s.frame.times_s[0] for s in seen])

    def compute() -> Arrays:
        own = moving_camera_series(
            [s.view for s in seen], [s.frame for s in seen], projections, labels_of(problem.aggregates),
            (s.left for s in seen), times,
        )  # fmt: skip
        return {"sides": own.sides, "normals": own.normals, "axes": own.axes}

    kept = parts("regions", compute)
    return RegionSeries(times, kept["sides"], kept["normals"], kept["axes"])


@dataclass(frozen=True)
class _MovingFit:
    """The least-squares fit of all frames."""

    problem: Problem
    seen: Sequence[_Frame]
    projections: Sequence[Projection]
    observations: Observations
    hz: np.ndarray
    config: MotionConfig
    parts: Parts

    @property
    def scale(self) -> float:
        """Of the functions of time, whose squares sum to 1 over all frames."""
        return float(np.sqrt(2 / len(self.seen)))

    @property
    def functions(self) -> np.ndarray:
        """[R, F]: the sinusoids, then a constant and slow polynomials."""
        times = np.array([s.frame.times_s[0] for s in self.seen])
        span = max(float(np.ptp(times)), 1e-9)
        degree = max(round(2 * _SLOW_BELOW * float(self.hz.min()) * span / 2), 1)
        slow = legendre.legvander(2 * (times - times.min()) / span - 1, min(degree, 4)).T
        slow *= 1 / np.sqrt((slow**2).sum(1, keepdims=True))
        return np.concatenate([self.scale * sinusoids(times, self.hz), slow])

    def folds(self) -> tuple[np.ndarray, float]:
        """[P, 2K, N, 6] of each half of the frames, and the smoothness weight."""
        functions = self.functions.astype(np.float32)
        weights = np.stack([s.weights for s in self.seen])
        images = np.stack([s.left for s in self.seen])[:, None]
        mixing = [functions[:, f][None] for f in range(functions.shape[1])]
        problem = replace(self.problem, mixing=mixing, projections=list(self.projections), _kept={})
        folds = folds_of(len(self.seen), self.observations.size, True, self.config.split_half)

        def select() -> Arrays:
            weight = self.config.smoothness_weight
            if not weight:
                few = [replace(fold, views=fold.views[::_THINNED]) for fold in folds]
                weight = DEFAULT if len(folds) == 1 else chosen_weight(images, problem, few, weights, 4)
            return {"smoothness_weight": np.array(weight)}

        weight = float(self.parts("smoothness", select)["smoothness_weight"])
        n = 2 * len(self.hz)
        found = []
        for p, fold in enumerate(folds):

            def solve(fold: Fold = fold, p: int = p) -> Arrays:
                return self._solved(problem, fold, images, weights, weight, p)

            found.append(self.parts(f"moving_{p}", solve))
        return np.stack([self.still(f["fields"][:n]) for f in found]), weight

    def _solved(
        self, problem: Problem, fold: Fold, images: np.ndarray, weights: np.ndarray, weight: float, p: int
    ) -> Arrays:
        operator = problem.operator(fold, weights, weight)
        b = operator.right_hand_sides(images[v] for v in fold.views)
        iterations = min(self.config.iterations, _MOST_ITERATIONS)
        with progress(f"motion, half {p + 1}", iterations, "iterations") as update:
            tell = _telling(update)
            solution = pcg(operator, b, iterations, self.config.tolerance, update=tell)
        return {"fields": operator.fields(solution.theta)}

    def still(self, fields: np.ndarray) -> np.ndarray:
        """Fields [2K, N, 6] with the background still, each frequency by itself."""
        means, seen = self.problem.gaussians.means.numpy(), self._seen_weights
        pairs = [with_still_background(fields[k : k + 2], means, seen) for k in range(0, len(fields), 2)]
        return np.concatenate(pairs)

    @cached_property
    def _seen_weights(self) -> np.ndarray:
        """[N]: how much is seen of each Gaussian, in some frames."""
        total = np.zeros(self.problem.n_gaussians)
        for own in self.seen[:: max(len(self.seen) // _JUDGED, 1)]:
            ones = np.ones((*own.view.transmittance.shape, 3), np.float32)
            total += blend_sum(own.view, ones)[:, 0]
        return total

    def found(self, folds: np.ndarray, shapes: np.ndarray) -> Found:
        """For the uncertainty: residuals of some frames, as if each had been seen by all functions of time."""
        rows = np.linspace(0, len(self.seen) - 1, min(_JUDGED, len(self.seen))).round().astype(int)
        functions, n = self.functions.astype(np.float32), 2 * len(self.hz)
        residuals = []
        for f in rows:
            field = np.tensordot(functions[:n, f], shapes, 1)[None]
            residuals.append(self.seen[f].left[None] - self.seen[f].view.jvp(field))
        views, cameras = [self.seen[f].view for f in rows], [self.seen[f].frame for f in rows]
        return Found(folds, shapes, self.problem.gaussians, self.problem.graph.knn, views, cameras, residuals)


def _telling(update: Callable[..., None]) -> Callable[[int, float], None]:
    return lambda done, residual: update(done, residual=round(residual, 4))
