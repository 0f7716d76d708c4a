"""Prepare a run, or a fit without one, for measurements: one pass through its pictures, which sensors then do not need.

For a moving camera every frame is a view with its own pose, Jacobian and nuisance. The run keeps the scene at rest as
it was refined on all frames, but not their poses, which the motion stage's own step corrects once more. The residual of
a frame is I_f − Î_f − J_f M x(τ_f), with exposure and pose projected out. The slow part of a sensor's answer, which
depends on errors of the scene at rest that change with the viewpoint, is removed as polynomials.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.polynomial import legendre

from tg4mm.capture import Capture, ImageStack, load_capture
from tg4mm.capture.pictures import FilePictures, pictures_for
from tg4mm.capture.scene import between_frames, video_file
from tg4mm.core.choices import Clock
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import no_checkpoint
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian, blend_sum, view_jacobian
from tg4mm.fit.motion.large.registration import mean_pictures
from tg4mm.fit.motion.modes import MotionFit
from tg4mm.fit.motion.nuisance.fixed_cameras import FixedCameras, prepare_fixed_cameras, rest_views
from tg4mm.fit.motion.nuisance.poses import corrected_poses, left_of, pictures_of
from tg4mm.fit.motion.nuisance.projection import COLUMNS, EXPOSURE, Nuisance, nuisances_of, without
from tg4mm.fit.motion.observations import Observations, PosedFrames, observe
from tg4mm.run import Run
from tg4mm.run.checks import check_readout, check_times
from tg4mm.run.stages import look_of
from tg4mm.show.measure.residuals import (
    MeasuredView,
    halves_of,
    packed_mean,
    packed_weights,
    pull_back,
    sampled,
    shown_fields,
    unpacked_mean,
    weighed,
)
from tg4mm.show.measure.scene import ModalFields, Prepared, SharedClock, clock_phases, zeros_on_disk
from tg4mm.show.measure.sensors import MeasureError
from tg4mm.show.measure.stored_pass import HALVES, RightHandSides, StoredPass, Wanted

_PERIODS = 8.0  # of the lowest frequency that a moving camera resolves (`temporal/moving.py`)
_MOST_SLOW = 12  # degree of the polynomials
_ALL = np.ones(12, bool)


@dataclass(frozen=True)
class FrameViews(Sequence[MeasuredView]):
    """The views of all frames, each made on demand: together they take gigabytes."""

    gaussians: Gaussians
    frames: Sequence[PosedFrames]
    size: tuple[int, int]
    level: np.ndarray  # [F] weight of every pixel of a frame: one over the mean square of its residual

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, k):
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        k = range(len(self))[k]
        view = view_jacobian(self.gaussians, self.frames[k], self.size)
        return self.of(k, view, self.level[k])

    def __iter__(self) -> Iterator[MeasuredView]:
        return (self[k] for k in range(len(self)))

    def of(self, k: int, view: ViewJacobian, level: float) -> MeasuredView:
        """Return frame k with equal pixel weights; both halves are squares of its picture."""
        nuisance = Nuisance(view, self.frames[k], self.gaussians.means.numpy(), _ALL)
        weights = np.full(self.size[::-1], level, np.float32)
        return MeasuredView(view, self.frames[k], nuisance, view.over_white, weights, (0, 1))


def prepare(run: Run, keep: bool = True) -> Prepared:
    """Read the run's pictures once, for any number of measurements; a flat capture's are read by each measurement.

    Args:
        run: a finished run.
        keep: cache what is read in RUN/residuals.safetensors, for later calls: 12 bytes for each frame and visible
            Gaussian, if that is under 1 GiB and the folder can be written. Nothing is cached for a flat capture.

    Returns:
        What `measure` takes.

    Raises:
        MeasureError: the dataset has one timestep.
        Tg4mmError: the run or its dataset cannot be read.
    """
    capture = load_capture(run.dataset, split="train")
    if capture.n_timesteps < 2:
        raise MeasureError(
            f"{run.path}: its dataset {run.dataset} has one timestep; a measurement needs pictures over time"
        )
    fit = run.load_fit()
    times = (fit.motion.fps, fit.motion.n_timesteps), (capture.fps, capture.n_timesteps)
    check_times(run.path, run.dataset, *times)
    check_readout(run.path, run.dataset, fit.figures, capture.rows_s)
    stored = StoredPass.of(run, keep)
    pictures = FilePictures(capture) if stored.is_there else pictures_for(capture)
    return _prepared(_unread(fit, capture, observe(capture, pictures), run.path), stored)


def prepare_fit(
    capture: Capture, fit: MotionFit, images: ImageStack | FilePictures | None = None
) -> Prepared:
    """Read the pictures of a fit once, for any number of measurements. Writes nothing.

    Args:
        capture: that `fit` was fitted to.
        fit: of `fit_motion`.
        images: the capture's pictures if they are read already (`load_images`); `None` reads them.

    Returns:
        What `measure` takes.

    Raises:
        CaptureError: a picture cannot be read, or too few show motion.
        MeasureError: the capture has one timestep.
    """
    if capture.n_timesteps < 2:
        raise MeasureError(f"{capture.root}: has one timestep; a measurement needs pictures over time")
    return _prepared(_unread(fit, capture, observe(capture, images or pictures_for(capture)), None), None)


def _unread(fit: MotionFit, capture: Capture, observations: Observations, folder: Path | None) -> Prepared:
    """Return the scene before any picture is read."""
    n = len(fit.gaussians)
    return Prepared(fit, folder, capture, observations, ModalFields.of(fit.motion, n), (), (), np.zeros(n))


def _prepared(scene: Prepared, stored: StoredPass | None) -> Prepared:
    if scene.is_moving:
        return _moving(scene, stored)
    scene = _fixed(scene, stored) if scene.capture.kind.sees_depth else _flat(scene)
    if len(scene.observations.frames) != 1:
        return scene
    root = scene.capture.root
    b_frames = between_frames(root, len(scene.observations.frames[0].rows))
    look = None if scene.folder is None else look_of(Run.open(scene.folder))
    return replace(scene, video=video_file(root), b_frames=b_frames, found=look)


def _moving(scene: Prepared, stored: StoredPass | None) -> Prepared:
    """Prepare the capture of a moving camera."""
    gaussians, observations = scene.gaussians, scene.observations
    times = np.array([f.times_s[0] for f in observations.frames])
    series, count = scene.modal.series(times), len(times)
    wanted: Wanted = {
        "viewmats": (np.float64, (count, 4, 4)),
        "level": (np.float64, (count,)),
        "seen": (np.float64, (len(gaussians),)),
    }
    found = None if stored is None else stored.load(wanted, {"0": count}, len(gaussians))
    if found is None:
        arrays, right_hand_sides = _moving_pass(scene, series)
        if stored is not None:
            stored.save(arrays | right_hand_sides.arrays("0"), ())
    else:
        arrays, (right_hand_sides,) = found
    frames = [replace(f, viewmat=v) for f, v in zip(observations.frames, arrays["viewmats"], strict=True)]
    return replace(
        scene,
        observations=replace(observations, frames=frames),
        views=FrameViews(gaussians, frames, observations.size, arrays["level"]),
        clocks=(SharedClock("", tuple(range(count)), times, right_hand_sides, series),),
        seen=arrays["seen"].astype(np.float64),
        slow=_slow_functions(times, scene.modal.freqs_hz),
    )


def _moving_pass(scene: Prepared, series: np.ndarray) -> tuple[dict[str, np.ndarray], RightHandSides]:
    """Read every frame: corrected poses, levels, blending weights, and the right-hand sides.

    All pixels of a frame have the same weight: the residual holds the motion that the run's modes do not show.
    """
    gaussians, observations, fields = scene.gaussians, scene.observations, scene.modal.fields
    frames, _, _ = corrected_poses(gaussians, observations, 0)
    n, count, (width, height) = len(gaussians), len(frames), observations.size
    right_hand_sides = zeros_on_disk((HALVES, count, n, DOF), scene.folder)
    out = FrameViews(gaussians, frames, observations.size, np.ones(count))
    seen = np.zeros(n)
    with progress("pictures", count, "frames") as update:
        for k, picture in enumerate(pictures_of(observations)):
            view = view_jacobian(gaussians, frames[k], observations.size)
            left = left_of(picture, view.over_white)
            if len(fields):
                field = np.tensordot(series[:, k].astype(np.float32), fields, 1)
                left -= view.jvp(np.ascontiguousarray(field[None]))[0]
            first = out.of(k, view, 1)
            cleaned = without(first.nuisance, first.mean, left[None])
            out.level[k] = 1 / max(float((cleaned**2).mean()), 1e-12)
            for half, model in out.of(k, view, out.level[k]).models():
                model.adjoint(left[None], right_hand_sides[half, k : k + 1])
            seen += blend_sum(view, np.ones((height, width, 3), np.float32))[:, 0]
            update(k + 1)
    viewmats = np.stack([f.viewmat for f in frames], dtype=np.float64)
    return {"viewmats": viewmats, "level": out.level, "seen": seen}, RightHandSides.of(right_hand_sides)


def _slow_functions(times_s: np.ndarray, freqs_hz: np.ndarray) -> np.ndarray:
    """Return polynomials [S, F] up to half the lowest resolved (`_PERIODS` in the record) or known frequency."""
    span = max(float(np.ptp(times_s)), 1e-9)
    periods = min(_PERIODS, *(float(f) * span for f in freqs_hz if f > 0), _PERIODS)
    degree = int(np.clip(round(periods / 2), 1, min(_MOST_SLOW, len(times_s) // 4)))
    return legendre.legvander(2 * (times_s - times_s.min()) / span - 1, degree).T


def _flat(scene: Prepared) -> Prepared:
    """Prepare a capture whose sensors are regions of the picture (`flat.py`): only camera shake is removed."""
    seen = seen_weights(rest_views(scene.gaussians, scene.observations), len(scene.gaussians))
    scene = replace(scene, clocks=_clocks(scene), seen=seen)
    if "pose" not in scene.fit.figures.get("nuisance", ["pose"]):
        return scene
    found = _look(scene)
    return replace(scene, observations=found.observations, notes=tuple(found.notes))


def _fixed(scene: Prepared, stored: StoredPass | None) -> Prepared:
    """Prepare a capture of fixed cameras, from what an earlier call has cached or from the pictures."""
    clocks, frames, (width, height) = _clocks(scene), scene.observations.frames, scene.observations.size
    wanted: Wanted = {
        "mean": (np.int16, (len(frames), height, width, 3)),
        "active": (np.uint8, (len(frames), COLUMNS)),
        "weights": (np.float16, (len(frames), height, width)),
        "unit": (np.float32, (len(frames),)),
    }
    n_frames = {str(c): len(clock.times_s) for c, clock in enumerate(clocks)}
    found = None if stored is None else stored.load(wanted, n_frames, len(scene.gaussians))
    if stored is not None and found is not None:
        arrays, right_hand_sides = found
        views = _views(scene, frames, unpacked_mean(arrays["mean"]), arrays["active"].astype(bool))
        weights = arrays["weights"].astype(np.float32) * arrays["unit"][:, None, None]
        views = [replace(v, weights=w) for v, w in zip(views, weights, strict=True)]
        notes = stored.notes
    else:
        observations, means, active, notes = _looked(scene)
        means = unpacked_mean(packed_mean(means))  # as a later call will have it
        views, right_hand_sides = _pass(
            scene, observations, _views(scene, observations.frames, means, active), clocks
        )
        if stored is not None:
            _keep(stored, views, right_hand_sides, notes)
    clocks = tuple(replace(c, right_hand_sides=s) for c, s in zip(clocks, right_hand_sides, strict=True))
    seen = seen_weights([v.view for v in views], len(scene.gaussians))
    return replace(scene, views=views, clocks=clocks, seen=seen, notes=tuple(notes))


def _look(scene: Prepared) -> FixedCameras:
    """Look at the pictures as the motion stage does: shake, exposure, mean pictures."""
    return prepare_fixed_cameras(
        scene.gaussians, scene.observations, scene.fit.config, "cpu", no_checkpoint, refines=False
    )


def _looked(scene: Prepared) -> tuple[Observations, np.ndarray, np.ndarray, list[str]]:
    """Return observations without shake, mean pictures [V, H, W, 3], active nuisance columns [V, 12], and notes."""
    known = scene.fit.figures.get("nuisance")
    if known is not None and "pose" not in known:  # the motion stage found no shake
        active = np.zeros((len(scene.observations.frames), COLUMNS), bool)
        active[:, EXPOSURE] = "exposure" in known
        return scene.observations, mean_pictures(scene.observations), active, []
    found = _look(scene)
    return found.observations, found.sums.mean, np.stack([n.active for n in found.nuisances]), found.notes


def _views(
    scene: Prepared, frames: Sequence[PosedFrames], means: np.ndarray, active: np.ndarray
) -> list[MeasuredView]:
    views = rest_views(scene.gaussians, scene.observations)
    nuisances = nuisances_of(views, frames, scene.gaussians.means.numpy(), active[0])
    is_shared = scene.observations.clock == Clock.synchronous
    halves = halves_of(len(frames) if is_shared else 1)
    return [
        MeasuredView(
            view, own, replace(nuisance, active=active[v]), means[v], np.ones(means[v].shape[:2], np.float32),
            halves[v if is_shared else 0],
        )
        for v, (view, own, nuisance) in enumerate(zip(views, frames, nuisances, strict=True))
    ]  # fmt: skip


def _clocks(scene: Prepared) -> tuple[SharedClock, ...]:
    """Return the clocks of fixed cameras, without right-hand sides."""
    frames, modal = scene.observations.frames, scene.modal
    if scene.observations.clock == Clock.synchronous:
        times = frames[0].times_s
        series = modal.series(times - times[0])  # the modes begin with the first picture
        return (SharedClock("", tuple(range(len(frames))), times, None, _centred(series)),)
    phases = [clock_phases(scene.fit.figures, own.name, modal.freqs_hz) for own in frames]
    return tuple(
        SharedClock(own.name, (v,), own.times_s, None, _centred(modal.series(own.times_s, ahead)))
        for v, (own, ahead) in enumerate(zip(frames, phases, strict=True))
    )


def _pass(
    scene: Prepared, observations: Observations, views: Sequence[MeasuredView], clocks: Sequence[SharedClock]
) -> tuple[list[MeasuredView], list[RightHandSides]]:
    """Read every picture: return the views with weights, and the right-hand sides of every clock."""
    out, right_hand_sides = list(views), []
    counts = [len(v.frames.rows) for v in views]
    total, done = sum(len(sampled(n)) for n in counts) + sum(counts), 0
    with progress("pictures", total, "frames") as update:

        def step(frames: int) -> None:
            nonlocal done
            done += frames
            update(done)

        for clock in clocks:
            own = zeros_on_disk((HALVES, len(clock.times_s), len(scene.gaussians), DOF), scene.folder)
            for v in clock.views:
                shown = shown_fields(views[v].view, scene.modal.fields)
                out[v] = weighed(observations, views[v], shown, clock.series, step)
                pull_back(observations, out[v], shown, clock.series, own, step)
            right_hand_sides.append(RightHandSides.of(own))
    return out, right_hand_sides


def _keep(
    stored: StoredPass,
    views: Sequence[MeasuredView],
    right_hand_sides: Sequence[RightHandSides],
    notes: Sequence[str],
) -> None:
    weights, units = zip(*(packed_weights(v.weights) for v in views), strict=True)
    arrays = {
        "mean": np.stack([packed_mean(v.mean) for v in views]),
        "active": np.stack([v.nuisance.active for v in views]).astype(np.uint8),
        "weights": np.stack(weights),
        "unit": np.array(units),
    }
    for c, own in enumerate(right_hand_sides):
        arrays |= own.arrays(str(c))
    stored.save(arrays, notes)


def seen_weights(views: Sequence[ViewJacobian], n_gaussians: int) -> np.ndarray:
    """Return the blending weight [N] of every Gaussian, pixels, summed over views."""
    out = np.zeros(n_gaussians)
    for view in views:
        out += blend_sum(view, np.ones((*view.transmittance.shape, 3), np.float32))[:, 0]
    return out


def _centred(series: np.ndarray) -> np.ndarray:
    return series - series.mean(1, keepdims=True)
