"""A run, or a fit without one, made ready to be measured: one pass through its pictures, of which sensors need none.

Of a moving camera every frame is a view with a pose, Jacobian and nuisance of its own. The run keeps the scene at rest
as it was refined on all frames, not their poses: these are corrected once more, by the motion stage's own step. What is
left of a frame is I_f − Î_f − J_f M x(τ_f), exposure and pose projected out; the slow part of a sensor's answer, which
the scene at rest still gets wrong with the viewpoint, is taken out as polynomials.
"""

import logging
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
from tg4mm.show.measure.kept import HALVES, Kept, KeptPass, Sides, Wanted
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
from tg4mm.show.measure.scene import ModalFields, Prepared, SharedClock, clock_phases, zeros_in_room
from tg4mm.show.measure.sensors import MeasureError

_PERIODS = 8.0  # of the lowest frequency that a moving camera tells (`temporal/moving.py`)
_MOST_SLOW = 12  # polynomials' degree
_ALL = np.ones(12, bool)
_LOG = logging.getLogger("tg4mm")


@dataclass(frozen=True)
class FrameViews(Sequence[MeasuredView]):
    """The views of all frames, made when they are asked for: together they take gigabytes."""

    gaussians: Gaussians
    frames: Sequence[PosedFrames]
    size: tuple[int, int]
    level: np.ndarray  # [F] weight of every pixel of a frame: one over the mean square of what is left of it

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
        """Frame k with pixels of one weight; both halves are squares of its picture."""
        nuisance = Nuisance(view, self.frames[k], self.gaussians.means.numpy(), _ALL)
        weights = np.full(self.size[::-1], level, np.float32)
        return MeasuredView(view, self.frames[k], nuisance, view.over_white, weights, (0, 1))


def prepare_moving(
    fit: MotionFit,
    folder: Path | None,
    capture: Capture,
    observations: Observations,
    modal: ModalFields,
    kept: KeptPass | None,
) -> Prepared:
    """`prepare` of a camera that moves."""
    gaussians = fit.gaussians
    times = np.array([f.times_s[0] for f in observations.frames])
    series = modal.series(times)
    count = len(times)
    wanted: Wanted = {
        "viewmats": (np.float64, (count, 4, 4)),
        "level": (np.float64, (count,)),
        "seen": (np.float64, (len(gaussians),)),
    }
    found = None if kept is None else kept.load(wanted, {"0": count}, len(gaussians))
    if found is None:
        arrays, sides = _passed(folder, observations, gaussians, modal, series)
        if kept is not None:
            kept.save(arrays | sides.arrays("0"), ())
    else:
        arrays, (sides,) = found
    frames = [replace(f, viewmat=v) for f, v in zip(observations.frames, arrays["viewmats"], strict=True)]
    views = FrameViews(gaussians, frames, observations.size, arrays["level"])
    clock = SharedClock("", tuple(range(len(frames))), times, sides, series)
    observations = replace(observations, frames=frames)
    return Prepared(
        fit, folder, capture, observations, modal, views, (clock,), arrays["seen"].astype(np.float64),
        slow=_slow_functions(times, modal.freqs_hz),
    )  # fmt: skip


def _passed(
    folder: Path | None,
    observations: Observations,
    gaussians: Gaussians,
    modal: ModalFields,
    series: np.ndarray,
) -> tuple[dict[str, np.ndarray], Sides]:
    frames, _, _ = corrected_poses(gaussians, observations, 0)
    n, count = len(gaussians), len(frames)
    width, height = observations.size
    sides = zeros_in_room((HALVES, count, n, DOF), folder)
    out = FrameViews(gaussians, frames, observations.size, np.ones(count))
    seen = np.zeros(n)
    with progress("pictures", count, "frames") as update:
        for k, picture in enumerate(pictures_of(observations)):
            view = view_jacobian(gaussians, frames[k], observations.size)
            left = left_of(picture, view.over_white)
            if len(modal.fields):
                field = np.tensordot(series[:, k].astype(np.float32), modal.fields, 1)
                left -= view.jvp(np.ascontiguousarray(field[None]))[0]
            _pull_back(out, k, view, left, sides)
            seen += blend_sum(view, np.ones((height, width, 3), np.float32))[:, 0]
            update(k + 1)
    arrays = {
        "viewmats": np.stack([f.viewmat for f in frames], dtype=np.float64),
        "level": out.level,
        "seen": seen,
    }
    return arrays, Sides.of(sides)


def _pull_back(out: FrameViews, k: int, view: ViewJacobian, left: np.ndarray, sides: np.ndarray) -> None:
    """The level of frame k, by what is left of it without exposure and pose, and its sides.

    All pixels of a frame count alike: what is left holds the motion that the run's modes do not show.
    """
    first = out.of(k, view, 1)
    own = without(first.nuisance, first.mean, left[None])
    out.level[k] = 1 / max(float((own**2).mean()), 1e-12)
    for half, model in out.of(k, view, out.level[k]).models():
        model.adjoint(left[None], sides[half, k : k + 1])


def _slow_functions(times_s: np.ndarray, freqs_hz: np.ndarray) -> np.ndarray:
    """[S, F]: polynomials up to half the lowest frequency that is told, `_PERIODS` in the record, or was asked for."""
    span = max(float(np.ptp(times_s)), 1e-9)
    periods = min(_PERIODS, *(float(f) * span for f in freqs_hz if f > 0), _PERIODS)
    degree = int(np.clip(round(periods / 2), 1, min(_MOST_SLOW, len(times_s) // 4)))
    return legendre.legvander(2 * (times_s - times_s.min()) / span - 1, degree).T


def prepare(run: Run, keep: bool = True) -> Prepared:
    """Read the run's pictures once, for any number of measurements; a flat capture's are read by each measurement.

    Args:
        run: a finished run.
        keep: keep what is read in RUN/residuals.safetensors, for later calls: 12 bytes for each frame and visible
            Gaussian, if that is under 1 GiB and the folder can be written. Nothing is kept of a flat capture.

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
    kept = KeptPass.of(run, keep)
    pictures = FilePictures(capture) if kept.is_there else pictures_for(capture)
    return _prepared(fit, run.path, capture, observe(capture, pictures), kept)


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
    return _prepared(fit, None, capture, observe(capture, images or pictures_for(capture)), None)


def _prepared(
    fit: MotionFit,
    folder: Path | None,
    capture: Capture,
    observations: Observations,
    kept: KeptPass | None,
) -> Prepared:
    modal = ModalFields.of(fit.motion, len(fit.gaussians))
    if observations.clock == Clock.moving:
        return prepare_moving(fit, folder, capture, observations, modal, kept)
    own = _Fixed(fit, folder, capture, observations, modal, kept)
    found = own.flat() if not capture.kind.sees_depth else own.prepared()
    if len(observations.frames) != 1:
        return found
    between = between_frames(capture.root, len(observations.frames[0].rows))
    look = None if folder is None else look_of(Run.open(folder))
    return replace(found, video=video_file(capture.root), between=between, found=look)


@dataclass(frozen=True)
class _Fixed:
    fit: MotionFit
    folder: Path | None
    capture: Capture
    observations: Observations
    modal: ModalFields
    kept: KeptPass | None

    @property
    def gaussians(self) -> Gaussians:
        return self.fit.gaussians

    def flat(self) -> Prepared:
        """Prepare a capture whose sensors are regions of the picture (`flat.py`).

        Shake is taken out, nothing is read.
        """
        observations, notes = self.observations, []
        if "pose" in self.fit.figures.get("nuisance", ["pose"]):
            found = self._look()
            observations, notes = found.observations, found.notes
        seen = seen_weights(rest_views(self.gaussians, self.observations), len(self.gaussians))
        clocks = tuple(replace(c, sides=None) for c in self._clocks(self.observations.frames))
        return Prepared(
            self.fit, self.folder, self.capture, observations, self.modal, (), clocks, seen, tuple(notes)
        )

    def prepared(self) -> Prepared:
        clocks = self._clocks(self.observations.frames)
        found = None if self.kept is None else self._found(self.kept, clocks)
        sides: list[Sides]
        if self.kept is not None and found is not None:
            arrays, sides = found[0], list(found[1])
            means = unpacked_mean(arrays["mean"])
            views = self._views(self.observations.frames, means, arrays["active"].astype(bool))
            weights = arrays["weights"].astype(np.float32) * arrays["unit"][:, None, None]
            views = [replace(v, weights=w) for v, w in zip(views, weights, strict=True)]
            notes = tuple(self.kept.notes)
        else:
            observations, means, active, seen_notes = self._seen()
            means, notes = (
                unpacked_mean(packed_mean(means)),
                tuple(seen_notes),
            )  # as a later call will have it
            views = self._views(observations.frames, means, active)
            views, sides = self._passed(observations, views, clocks)
            if self.kept is not None:
                self._keep(self.kept, views, sides, notes)
        clocks = [replace(c, sides=s) for c, s in zip(clocks, sides, strict=True)]
        return Prepared(
            self.fit, self.folder, self.capture, self.observations, self.modal, views, tuple(clocks),
            seen_weights([v.view for v in views], len(self.gaussians)), notes,
        )  # fmt: skip

    def _found(self, kept: KeptPass, clocks: Sequence[SharedClock]) -> Kept | None:
        """What an earlier call has kept."""
        count, (width, height) = len(self.observations.frames), self.observations.size
        wanted: Wanted = {
            "mean": (np.int16, (count, height, width, 3)),
            "active": (np.uint8, (count, COLUMNS)),
            "weights": (np.float16, (count, height, width)),
            "unit": (np.float32, (count,)),
        }
        n_frames = {str(c): len(clock.times_s) for c, clock in enumerate(clocks)}
        return kept.load(wanted, n_frames, len(self.gaussians))

    def _look(self) -> FixedCameras:
        """Look at the pictures as the motion stage does: shake, exposure, mean pictures."""
        return prepare_fixed_cameras(
            self.gaussians, self.observations, self.fit.config, "cpu", no_checkpoint, refines=False
        )

    def _seen(self) -> tuple[Observations, np.ndarray, np.ndarray, list[str]]:
        """Observations without shake, mean pictures [V, H, W, 3], active nuisance columns [V, 12], notes.

        Where the motion stage says that no camera shakes, there is no need to look again.
        """
        known = self.fit.figures.get("nuisance")
        if known is not None and "pose" not in known:
            active = np.zeros((len(self.observations.frames), COLUMNS), bool)
            active[:, EXPOSURE] = "exposure" in known
            return self.observations, mean_pictures(self.observations), active, []
        found = self._look()
        active = np.stack([n.active for n in found.nuisances])
        return found.observations, found.sums.mean, active, found.notes

    def _views(
        self, frames: Sequence[PosedFrames], means: np.ndarray, active: np.ndarray
    ) -> list[MeasuredView]:
        views = rest_views(self.gaussians, self.observations)
        nuisances = nuisances_of(views, frames, self.gaussians.means.numpy(), active[0])
        is_shared = self.observations.clock == Clock.synchronous
        halves = halves_of(len(frames) if is_shared else 1, True)
        return [
            MeasuredView(
                view, own, replace(nuisance, active=active[v]), means[v], np.ones(means[v].shape[:2], np.float32),
                halves[v if is_shared else 0],
            )
            for v, (view, own, nuisance) in enumerate(zip(views, frames, nuisances, strict=True))
        ]  # fmt: skip

    def _clocks(self, frames: Sequence[PosedFrames]) -> list[SharedClock]:
        nothing = Sides.of(np.zeros((HALVES, 0, 0, DOF), np.float32))
        if self.observations.clock == Clock.synchronous:
            times = frames[0].times_s
            series = _centred(self.modal.series(times - times[0]))  # the modes begin with the first picture
            return [SharedClock("", tuple(range(len(frames))), times, nothing, series)]
        out = []
        for v, own in enumerate(frames):
            phases = clock_phases(self.fit.figures, own.name, self.modal.freqs_hz)
            series = _centred(self.modal.series(own.times_s, phases))
            out.append(SharedClock(own.name, (v,), own.times_s, nothing, series))
        return out

    def _passed(
        self, observations: Observations, views: Sequence[MeasuredView], clocks: Sequence[SharedClock]
    ) -> tuple[list[MeasuredView], list[Sides]]:
        """Views with weights, and the sides of every clock, for which every picture is read."""
        out, sides = list(views), []
        counts = [len(v.frames.rows) for v in views]
        total, done = sum(len(sampled(n)) for n in counts) + sum(counts), 0
        with progress("pictures", total, "frames") as update:

            def step(frames: int) -> None:
                nonlocal done
                done += frames
                update(done)

            for clock in clocks:
                own = zeros_in_room((HALVES, len(clock.times_s), len(self.gaussians), DOF), self.folder)
                for v in clock.views:
                    shown = shown_fields(views[v].view, self.modal.fields)
                    out[v] = weighed(observations, views[v], shown, clock.series, step)
                    pull_back(observations, out[v], shown, clock.series, own, step)
                sides.append(Sides.of(own))
        return out, sides

    def _keep(
        self,
        kept: KeptPass,
        views: Sequence[MeasuredView],
        sides: Sequence[Sides],
        notes: Sequence[str],
    ) -> None:
        weights, units = zip(*(packed_weights(v.weights) for v in views), strict=True)
        arrays = {
            "mean": np.stack([packed_mean(v.mean) for v in views]),
            "active": np.stack([v.nuisance.active for v in views]).astype(np.uint8),
            "weights": np.stack(weights),
            "unit": np.array(units),
        }
        for c, own in enumerate(sides):
            arrays |= own.arrays(str(c))
        kept.save(arrays, notes)


def seen_weights(views: Sequence[ViewJacobian], n_gaussians: int) -> np.ndarray:
    """[N] blending weight of every Gaussian, pixels, summed over views."""
    out = np.zeros(n_gaussians)
    for view in views:
        out += blend_sum(view, np.ones((*view.transmittance.shape, 3), np.float32))[:, 0]
    return out


def _centred(series: np.ndarray) -> np.ndarray:
    return series - series.mean(1, keepdims=True)
