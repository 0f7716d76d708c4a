"""A run of a moving camera made ready: every frame is a view with a pose, Jacobian and nuisance of its own.

The run keeps the scene at rest as it was refined on all frames, not their poses: these are corrected once more, by the
motion stage's own step. What is left of a frame is I_f − Î_f − J_f M x(τ_f), exposure and pose projected out; the slow
part of a sensor's answer, which the scene at rest still gets wrong with the viewpoint, is taken out as polynomials.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.polynomial import legendre

from tg4mm.capture import Capture
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian, blend_sum, view_jacobian
from tg4mm.fit.motion.modes import MotionFit
from tg4mm.fit.motion.nuisance.poses import corrected_poses, left_of, pictures_of
from tg4mm.fit.motion.nuisance.projection import Nuisance, without
from tg4mm.fit.motion.observations import Observations, PosedFrames
from tg4mm.show.measure.kept import KeptPass, Wanted
from tg4mm.show.measure.modal_fields import ModalFields
from tg4mm.show.measure.residuals import MeasuredView
from tg4mm.show.measure.scene import Prepared, SharedClock, zeros_in_room
from tg4mm.show.measure.sides import HALVES, Sides

_PERIODS = 8.0  # of the lowest frequency that a moving camera tells (`temporal/moving.py`)
_MOST_SLOW = 12  # polynomials' degree
_ALL = np.ones(12, bool)


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
