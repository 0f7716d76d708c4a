"""The motion of a scene's Gaussians from observations: every step of the method, in order (docs/method.md)."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tg4mm.core.choices import Clock
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.amplitude_bias import LACKING, Gain, PictureGain, gain_of
from tg4mm.fit.motion.appearance import AppearanceFit, MotionResidual
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step, no_checkpoint
from tg4mm.fit.motion.config import MotionConfig, resolved
from tg4mm.fit.motion.hyperparameters import (
    Hyperparameters,
    noise_components,
    pixel_weights,
    select_smoothness,
)
from tg4mm.fit.motion.jacobian.view import false_changes
from tg4mm.fit.motion.large.gauss_newton import ABOVE_PX, gauss_newton, linear_px
from tg4mm.fit.motion.large.whole_pixels import LinearSolution, solve_whole_pixels
from tg4mm.fit.motion.linear_fit import Correction, LinearFit
from tg4mm.fit.motion.mode_selection import frequency_notes
from tg4mm.fit.motion.modes import ModalMotion, MotionFit
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.split_half import LEAST, wiener_shrink
from tg4mm.fit.motion.temporal import TemporalModel
from tg4mm.fit.motion.temporal.independent import IndependentClocks
from tg4mm.fit.motion.temporal.moving import MovingCamera
from tg4mm.fit.motion.temporal.synchronous import Synchronous
from tg4mm.fit.motion.uncertainty import (
    MotionEstimate,
    Uncertainty,
    coarser,
    few_view_uncertainty,
    split_half_uncertainty,
    unseen_motion,
    with_ground,
)

_SUPPORTS = 2  # fits within a support, at most
_ROUNDS = 2  # of corrections by the mean picture: a share that is lacking is lacking to its cube then
_DRAWS, _DRAW_ITERATIONS = 4, 8  # of motion that many cameras do not show: a fifth of the time of the fit
_DRAWN_PIXELS = 720_000  # of all views together
_JUDGED = 10  # views whose residual estimates errors of the model


def fit_motion(
    gaussians: Gaussians,
    observations: Observations,
    config: MotionConfig | None = None,
    device: str = "cpu",
    checkpoint: Checkpoint = no_checkpoint,
) -> MotionFit:
    """The modal motion of `gaussians` (at rest, on the CPU) that explains the observations.

    `checkpoint` keeps finished steps of a long fit (`checkpoints.py`). On CUDA the iterations run there; reading the
    pictures, their components, the neighbourhoods, one projection of each view, and appearance are left to the
    CPU. Raises RunError where no camera sees a Gaussian, Tg4mmError on settings out of range or where the
    device's memory is too small.
    """
    asked = config or MotionConfig()
    settings = resolved(asked, len(gaussians))
    models = {
        Clock.synchronous: Synchronous.of,
        Clock.independent: IndependentClocks.of,
        Clock.moving: MovingCamera.of,
    }
    model = models[observations.clock](gaussians, observations, settings, device, checkpoint)
    return replace(_fitted(model, checkpoint), config=asked)


def _fitted(model: TemporalModel, checkpoint: Checkpoint) -> MotionFit:
    """Hyperparameters, the linear fit, Gauss-Newton where motion is large; the folds' mean, its ± and its modes."""
    if not len(model.targets.basis):
        return without_motion(model)
    solution, count = _solved(model, checkpoint), 0
    if not solution.folds.shape[1]:
        return without_motion(solution.model)
    if _moves_by_pixels(solution):
        solution, count = solve_whole_pixels(solution, _solved, checkpoint)
    model, hyper, folds, gradients = solution.model, solution.hyper, solution.folds, solution.gradients
    fields, reliability = wiener_shrink(folds)
    pixels, n_views = model.pixels_moved(fields), len(model.problem.views)
    # views whose residual estimates errors of the model
    rows = np.linspace(0, n_views - 1, min(n_views, _JUDGED)).round().astype(int).tolist()
    figures: dict[str, Any] = {"pixels_moved": pixels * model.observations.factor, "gauss_newton": count}
    targets: Iterable[np.ndarray] = (model.images(v) for v in rows)
    iterates = (
        model.iterates and pixels > linear_px(len(model.problem.views)) and model.config.gauss_newton > 0
    )
    attenuation = Gain()
    if iterates:
        model, folds, targets, of_iterations = gauss_newton(model, hyper, folds, rows, checkpoint)
        figures |= of_iterations
    if not figures["gauss_newton"]:  # iterations that were taken have corrected the attenuation themselves
        attenuation = gain_of(model, folds)
        folds = folds * attenuation.places[:, None]
    fields, reliability = wiener_shrink(folds)
    estimate = replace(_estimate(model, folds, fields, rows, targets), attenuation=attenuation)
    uncertainty = _uncertainty(model, hyper, estimate, gradients)
    changes = None
    if not iterates and (appearance := _appearance_fit(model)) is not None:
        with progress("appearance", len(fields), "components") as update:
            changes, kept = appearance.fitted(_motion_residual(model, fields), update)
        figures["appearance_reliability"] = [round(float(g), 4) for g in kept]
    if len(folds) == 2:
        if not model.observations.is_flat:
            figures["picture_gain"] = round(estimate.gain.ratio, 4)
            figures["attenuation_gain"] = round(attenuation.ratio, 4)
        figures["reliability"] = [round(float(g), 4) for g in reliability]
    return _result(model, hyper, model.motion(fields, changes), uncertainty, figures)


def _solved(model: TemporalModel, checkpoint: Checkpoint) -> LinearSolution:
    """Hyperparameters and the linear fit; no fields where it leaves no motion."""
    model, hyper = select_hyperparameters(model, checkpoint)
    model = model.completed(hyper, checkpoint)
    folds, gradients = _linear_fit(model, hyper, checkpoint)
    model, folds = model.settled(folds)
    if model.observations.is_flat:
        folds = in_plane(folds, model.observations.frames[0].viewmat[2, :3])
    return LinearSolution(model, hyper, folds, gradients)


def _moves_by_pixels(solution: LinearSolution) -> bool:
    """Return whether one fixed camera sees vibration beyond the linear range."""
    model = solution.model
    is_put_back = (
        model.observations.is_flat and isinstance(model, Synchronous) and model.config.gauss_newton > 0
    )
    return is_put_back and model.pixels_moved(solution.vibration) > ABOVE_PX


def select_hyperparameters(
    model: TemporalModel, checkpoint: Checkpoint
) -> tuple[TemporalModel, Hyperparameters]:
    """Components of noise and the smoothness weight, and between them weights of pixels for the model's problem."""

    def noise() -> Arrays:
        return {"is_noise": noise_components(model.targets, model.problem, model.folds)}

    is_noise = checkpoint(Step.noise, noise)["is_noise"].astype(bool)
    weights = pixel_weights(model.targets, is_noise, model.problem.mixing is None)
    if (valid := model.observations.valid_mask) is not None:
        weights = valid.astype(np.float32) if weights is None else weights * valid
    weighted = replace(model, problem=model.problem.changed(pixel_weights=weights))

    def smoothness() -> Arrays:
        return {"smoothness_weight": np.array(select_smoothness(*weighted.strongest()))}

    weight = float(checkpoint(Step.smoothness, smoothness)["smoothness_weight"])
    return weighted, Hyperparameters(is_noise, weight)


def _linear_fit(
    model: TemporalModel, hyper: Hyperparameters, checkpoint: Checkpoint
) -> tuple[np.ndarray, np.ndarray]:
    """Fields [P, R, N, 6] of the folds; the mean over folds of their displacement and gradient, [R, 4N, 3].

    Of synchronous cameras in two passes, with a deferred correction between them where motion is small, or, of one
    fixed camera, by its mean picture. Of a moving camera twice more, where only what was found to move may.
    """
    linear = LinearFit(model.problem, model.targets, hyper, model.folds, model.config, checkpoint)
    if not model.separates:
        last = linear.first_pass(model.first_iterations)
        for k in range(_SUPPORTS):
            support = model.support(np.stack([f["fields"] for f in last]))
            if support is None:
                break
            last = linear.within(support, k)
        return np.stack([f["fields"] for f in last]), np.mean([f["x"] for f in last], axis=0)
    first = linear.first_pass()
    fields, _ = wiener_shrink(np.stack([f["fields"] for f in first]))
    is_small = model.pixels_moved(fields) <= ABOVE_PX
    correction: Correction | None = None
    rounds = 1
    if model.observations.is_flat or len(model.problem.views) == 1:
        correction, rounds = partial(_by_the_pictures, model), _ROUNDS
    elif is_small and (appearance := _appearance_fit(model)) is not None:
        correction = appearance.between_passes(_motion_residual(model, fields))
    return linear.second_pass(first, is_small, correction, rounds), np.mean([f["x"] for f in first], axis=0)


def _by_the_pictures(model: TemporalModel, p: int, fields: np.ndarray, some: slice) -> Iterator[np.ndarray]:
    """Return the motion that only the mean picture shows, the instrument (`Correction`)."""
    problem = model.problem
    return (
        -false_changes(problem.views[v], model.targets.mean[v], fields[some]) for v in model.folds[p].views
    )


def _appearance_fit(model: TemporalModel) -> AppearanceFit | None:
    """Return the fit of appearance; None if it is off, or with too few cameras to separate it from noise."""
    is_observable = len(model.problem.views) >= LEAST and len(model.folds) == 2
    if not (model.separates and model.config.appearance and is_observable):
        return None
    return AppearanceFit.of(model.problem, model.observations.frames, model.folds)


def _motion_residual(model: TemporalModel, fields: np.ndarray) -> MotionResidual:
    return MotionResidual(model.problem, model.targets.images, model.fitted, fields)


def in_plane(fields: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Fields [..., N, 6] in the plane across `normal` [3]: displacement within it, rotation about it.

    For a flat capture, whose one camera shows nothing of the rest.
    """
    out = fields.copy()
    out[..., :3] -= (fields[..., :3] @ normal)[..., None] * normal
    out[..., 3:] = (fields[..., 3:] @ normal)[..., None] * normal
    return out


def _estimate(
    model: TemporalModel,
    folds: np.ndarray,
    fields: np.ndarray,
    rows: list[int],
    targets: Iterable[np.ndarray],
) -> MotionEstimate:
    """Collect the estimate with the residual of some views' target images [ρ, H, W, 3]."""
    problem, frames, gain = model.problem, model.observations.frames, PictureGain()

    def residuals() -> Iterator[np.ndarray]:
        for v, images in zip(rows, targets, strict=True):
            if not model.observations.is_flat:
                gain.add(problem, v, folds.mean(0), images)
            yield problem.residual(v, images, fields)

    views, cameras = [problem.views[v] for v in rows], [frames[v] for v in rows]
    return MotionEstimate(
        folds, fields, model.gaussians, problem.graph.knn, views, cameras, residuals(), gain
    )


def _uncertainty(
    model: TemporalModel, hyper: Hyperparameters, estimate: MotionEstimate, gradients: np.ndarray
) -> Uncertainty | None:
    """Estimate the uncertainty from two folds of the data; for few cameras also of unseen motion."""
    problem = model.problem
    if len(estimate.folds) < 2:
        return None
    if len(problem.views) >= LEAST or model.observations.is_flat:
        unseen = _unseen(model, hyper, gradients) if model.iterates else None
        found = split_half_uncertainty(estimate, model.n_frames, unseen)
        return with_ground(found, model.ground_squares(), model.n_frames)
    small = coarser(problem, model.observations.frames)
    operator = small.on_cpu(small.everything, hyper.smoothness_weight)
    of_one_field = replace(operator, mixing=None)
    return few_view_uncertainty(estimate, of_one_field, gradients, model.n_frames, model.config.seed)


def _unseen(model: TemporalModel, hyper: Hyperparameters, gradients: np.ndarray) -> np.ndarray:
    """Return [N, 3, 3]: covariance of the motion that the pictures of many synchronous cameras do not show."""
    problem = model.problem
    small = coarser(problem, model.observations.frames, _DRAWN_PIXELS // len(problem.views))
    operator = small.on_cpu(small.everything, hyper.smoothness_weight)
    return unseen_motion(
        operator, gradients, model.n_frames, model.config.seed, n_draws=_DRAWS, iterations=_DRAW_ITERATIONS
    )[0]


def _result(
    model: TemporalModel,
    hyper: Hyperparameters,
    motion: ModalMotion,
    uncertainty: Uncertainty | None,
    figures: dict[str, Any],
) -> MotionFit:
    """Assemble the fit with its log and notes."""
    observations, notes = model.observations, [*model.notes]
    if observations.is_flat:
        notes.append("a flat capture shows only motion across the line of sight, in pixels")
    pixels = figures["pixels_moved"]
    if pixels > ABOVE_PX * observations.factor and not (model.iterates or figures["gauss_newton"]):
        notes.append(
            f"amplitudes of fine texture: the motion, {pixels:.2g} px, exceeds the linear range, "
            f"{ABOVE_PX * observations.factor:.2g} px, and this capture is not iterated; tg4mm measure shows whether "
            "they are too small"
        )
    if (gain := figures.get("picture_gain", 1.0)) > LACKING:
        notes.append(
            f"amplitudes: the pictures change {gain:.2g} times as much as the fitted motion predicts, since these "
            "cameras do not determine the depth well; add photographs or cameras from more sides"
        )
    if uncertainty is not None:
        figures, notes = figures | uncertainty.figures, [*notes, *uncertainty.notes]
    arrays = {} if uncertainty is None else uncertainty.arrays
    hz = model.peaks_hz(motion, arrays.get("noise"))
    figures = {
        "iterations": model.config.iterations,
        "smoothness_weight": hyper.smoothness_weight,
        "views": len(model.problem.views),
        "duration_s": round(observations.duration_s, 6),
        **model.figures,
        "n_frequencies": len(motion.freqs_hz),
        "frequencies_hz": [round(float(f), 4) for f in hz],
        **figures,
    }
    return MotionFit(model.gaussians, motion, arrays, figures, [*notes, *frequency_notes(hz, observations)])


def without_motion(model: TemporalModel) -> MotionFit:
    """Return the fit of a model in which no frequency stands out, or the halves of the data disagree."""
    empty = np.zeros((0, len(model.gaussians), 3), np.complex64)
    motion = ModalMotion.of_phasors(
        np.zeros(0), empty, empty, model.observations.fps, model.observations.n_timesteps
    )
    note = "no frequency stands out of the noise: the run holds no motion"
    hz = model.figures["frequencies_hz"]
    if model.ground_squares() is not None:
        note = ""  # the model's notes say why
    elif hz:
        named = ", ".join(f"{f:.4g}" for f in hz)
        note = (
            f"the motion at {named} Hz: the halves of the record disagree, so the run leaves it "
            f"out; {model.if_halves_disagree}"
        )
    figures = {"views": len(model.problem.views), **model.figures, "n_frequencies": 0}
    return MotionFit(model.gaussians, motion, {}, figures, [*model.notes, *([note] if note else [])])
