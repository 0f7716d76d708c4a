"""A run made ready to be measured: one pass through its pictures, after which a sensor takes no pictures at all."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.pictures import FilePictures
from tg4mm.gaussians import Gaussians
from tg4mm.measure.errors import MeasureError
from tg4mm.measure.kept import KeptPass
from tg4mm.measure.modal_fields import ModalFields, clock_phases
from tg4mm.measure.residuals import (
    HALVES,
    MeasuredView,
    halves_of,
    pull_back,
    shown_fields,
    total_bytes,
    weighed,
)
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.colour import blend_sum
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.modes import ModalMotion
from tg4mm.motion.nuisance import nuisances_of
from tg4mm.motion.nuisance_choice import Seen, look_again, look_at
from tg4mm.motion.observations import Observations, PosedFrames, observe
from tg4mm.motion.pipeline import rest_views
from tg4mm.motion.registration import camera_turns, registered
from tg4mm.progress import progress
from tg4mm.runs import Run
from tg4mm.train import pictures_for

IN_MEMORY = (
    1 << 30
)  # bytes of what is kept of the pictures; more lies in a temporary file of the run's folder
_LOG = logging.getLogger("tg4mm")


@dataclass(frozen=True)
class Clock:
    """Views whose frames were taken at the same times: all of a synchronous capture, one of a clip."""

    name: str  # "" where there is one clock
    views: tuple[int, ...]
    times_s: np.ndarray  # [F] seconds
    sides: np.ndarray  # [2, F, N, 6] float32, `residuals.py`
    series: np.ndarray  # [R, F] of the modal fields


@dataclass(frozen=True)
class Prepared:
    """What sensors are measured on. Raised for nothing after it is made: `measure` takes it any number of times."""

    run: Run
    capture: Capture
    observations: Observations
    gaussians: Gaussians
    motion: ModalMotion | None
    modal: ModalFields
    views: Sequence[MeasuredView]
    clocks: tuple[Clock, ...]
    seen: np.ndarray  # [N] blending weight, pixels, summed over the views
    notes: tuple[str, ...] = ()
    slow: np.ndarray | None = (
        None  # [S, F] functions of time that a moving camera cannot tell from its own motion
    )

    @property
    def means(self) -> np.ndarray:
        """[N, 3] scene units."""
        return np.asarray(self.gaussians.means.numpy(), np.float64)

    @property
    def is_moving(self) -> bool:
        return self.observations.clock == "moving"


def prepare(run: Run, keep: bool = True) -> Prepared:
    """Read the run's pictures once, or take what an earlier call kept (RUN/residuals.safetensors).

    keep: write that file, 48 bytes for each frame and Gaussian, where it is under 1 GiB and the folder can be written.
    Raises MeasureError where the run has no pictures over time, Tg4mmError for a run or dataset that cannot be read.
    """
    capture = load_capture(run.dataset, split="train")
    if capture.n_timesteps < 2:
        raise MeasureError(
            f"{run.path}: its dataset {run.dataset} has one timestep; a measurement needs pictures over time"
        )
    gaussians, motion = run.load_space(), run.load_motion()
    if motion is None:
        raise MeasureError(f"{run.path} has no motion.safetensors: its training is not finished")
    kept = KeptPass.of(run, keep)
    pictures = FilePictures(capture) if kept.is_there else pictures_for(capture)
    observations = observe(capture, pictures)
    modal = ModalFields.of(motion, len(gaussians))
    if observations.clock == "moving":
        from tg4mm.measure.moving import prepare_moving

        return prepare_moving(run, capture, observations, gaussians, motion, modal, kept)
    return _Fixed(run, capture, observations, gaussians, motion, modal, kept).prepared()


@dataclass(frozen=True)
class _Fixed:
    """Fixed cameras."""

    run: Run
    capture: Capture
    observations: Observations
    gaussians: Gaussians
    motion: ModalMotion
    modal: ModalFields
    kept: KeptPass

    def prepared(self) -> Prepared:
        clocks = self._clocks(self.observations.frames)
        if (arrays := self.kept.load()) is not None:
            views = self._views(self.observations.frames, arrays["mean"], arrays["active"])
            views = [replace(v, weights=w) for v, w in zip(views, arrays["weights"], strict=True)]
            sides = [arrays[f"sides_{c}"] for c in range(len(clocks))]
            notes = tuple(self.kept.notes)
        else:
            seen, observations = self._seen()
            active = np.stack([n.active for n in seen.nuisances])
            views = self._views(observations.frames, np.asarray(seen.look.mean), active)
            views, sides = self._passed(observations, views, clocks)
            notes = tuple(seen.notes)
            self._keep(views, sides, notes)
        clocks = [replace(c, sides=s) for c, s in zip(clocks, sides, strict=True)]
        return Prepared(
            self.run, self.capture, self.observations, self.gaussians, self.motion, self.modal, views,
            tuple(clocks), seen_weights(views, len(self.gaussians)), notes,
        )  # fmt: skip

    def _seen(self) -> tuple[Seen, Observations]:
        """Nuisance columns and means as the motion stage finds them, and pictures turned back where cameras shake."""
        config = MotionConfig(**self.run.settings.get("motion", {}))
        observations = self.observations
        views = rest_views(self.gaussians, observations)
        seen = look_at(observations, views, self.gaussians, config)
        if seen.is_shaking:
            turns = camera_turns(observations)
            observations = registered(observations, turns)
            focal = max(float(f.K[0, 0]) for f in observations.frames)
            pixels = focal * float(np.sqrt((turns[:, :2] ** 2).sum(1).mean()))
            seen = look_again(observations, views, self.gaussians, seen, pixels)
        return seen, observations

    def _views(
        self, frames: Sequence[PosedFrames], means: np.ndarray, active: np.ndarray
    ) -> list[MeasuredView]:
        views = rest_views(self.gaussians, self.observations)
        nuisances = nuisances_of(views, frames, self.gaussians.means.numpy(), active[0])
        is_shared = self.observations.clock == "synchronous"
        halves = halves_of(len(frames) if is_shared else 1, True)
        return [
            MeasuredView(
                view, own, nuisance.with_active(active[v]), means[v], np.ones(means[v].shape[:2], np.float32),
                halves[v if is_shared else 0],
            )
            for v, (view, own, nuisance) in enumerate(zip(views, frames, nuisances, strict=True))
        ]  # fmt: skip

    def _clocks(self, frames: Sequence[PosedFrames]) -> list[Clock]:
        nothing = np.zeros((HALVES, 0, len(self.gaussians), DOF), np.float32)
        if self.observations.clock == "synchronous":
            times = frames[0].times_s
            series = _centred(self.modal.series(times))
            return [Clock("", tuple(range(len(frames))), times, nothing, series)]
        log = self.run.log()
        out = []
        for v, own in enumerate(frames):
            phases = clock_phases(log, own.name, self.modal.freqs_hz)
            series = _centred(self.modal.series(own.times_s, phases))
            out.append(Clock(own.name, (v,), own.times_s, nothing, series))
        return out

    def _passed(
        self, observations: Observations, views: Sequence[MeasuredView], clocks: Sequence[Clock]
    ) -> tuple[list[MeasuredView], list[np.ndarray]]:
        """The one pass: views with weights, and the sides of every clock."""
        counts = [len(c.times_s) for c in clocks]
        n = len(self.gaussians)
        is_large = total_bytes(counts, n) > IN_MEMORY
        out, sides = (
            list(views),
            [zeros((HALVES, f, n, DOF), self.run.path if is_large else None) for f in counts],
        )
        with progress("pictures", len(views), "cameras") as update:
            done = 0
            for c, clock in enumerate(clocks):
                for v in clock.views:
                    shown = shown_fields(views[v].view, self.modal.fields)
                    out[v] = weighed(observations, views[v], shown, clock.series)
                    pull_back(observations, out[v], shown, clock.series, sides[c])
                    done += 1
                    update(done)
        return out, sides

    def _keep(self, views: Sequence[MeasuredView], sides: Sequence[np.ndarray], notes: Sequence[str]) -> None:
        arrays = {
            "mean": np.stack([v.mean for v in views]).astype(np.float32),
            "active": np.stack([v.nuisance.active for v in views]),
            "weights": np.stack([v.weights for v in views]),
            **{f"sides_{c}": s for c, s in enumerate(sides)},
        }
        if sum(a.nbytes for a in arrays.values()) <= IN_MEMORY:
            self.kept.save(arrays, notes)


def seen_weights(views: Sequence[MeasuredView], n_gaussians: int) -> np.ndarray:
    """[N] blending weight of every Gaussian, pixels, summed over views."""
    out = np.zeros(n_gaussians)
    for view in views:
        out += blend_sum(view.view, np.ones_like(view.mean))[:, 0]
    return out


def zeros(shape: tuple[int, ...], folder: Path | None) -> np.ndarray:
    """Zeros [*shape] float32, in memory or in an unnamed temporary file of `folder`."""
    if folder is None:
        return np.zeros(shape, np.float32)
    where = folder if os.access(folder, os.W_OK) else None
    with tempfile.TemporaryFile(dir=where, prefix=".measure") as file:
        return np.memmap(file, np.float32, "w+", shape=shape)


def _centred(series: np.ndarray) -> np.ndarray:
    """Changes are from the mean over time."""
    return series - series.mean(1, keepdims=True)
