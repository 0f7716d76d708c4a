"""What a measurement is made of: the run or fit, its views and clocks, and what was read of its pictures."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture
from tg4mm.capture.look import Found
from tg4mm.capture.pictures import Strips
from tg4mm.capture.scene import VideoFile
from tg4mm.core.choices import Clock
from tg4mm.core.memory import mapped_zeros
from tg4mm.core.regions import Scale
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.modes import ModalMotion, MotionFit
from tg4mm.fit.motion.observations import Observations
from tg4mm.show.measure.kept import Sides
from tg4mm.show.measure.residuals import MeasuredView

_WEAKEST = 1e-9  # of the strongest field's energy
IN_MEMORY = 1 << 30  # bytes that a pass through the pictures adds up; more lies in a temporary file


@dataclass(frozen=True)
class ModalFields:
    """Motion at a time: Σ_r (mixing @ [Re g; Im g])_r fields[r], with the modes' gains g."""

    fields: np.ndarray  # [R, N, 6] float32, displacement (scene units) and rotation vector (radians)
    mixing: np.ndarray  # [R, 2K] float64
    freqs_hz: np.ndarray  # [K]

    @staticmethod
    def of(motion: ModalMotion | None, n_gaussians: int) -> "ModalFields":
        """Make the fields of a run's motion; no field where it has none."""
        if motion is None or not len(motion.freqs_hz):
            return ModalFields(np.zeros((0, n_gaussians, DOF), np.float32), np.zeros((0, 0)), np.zeros(0))
        both = np.concatenate([motion.displacement, motion.rotation], 2).reshape(len(motion.freqs_hz), -1)
        rows = np.concatenate([both.real, -both.imag]).astype(np.float32)
        shifts = np.concatenate([motion.displacement.real, -motion.displacement.imag]).reshape(len(rows), -1)
        values, vectors = np.linalg.eigh((shifts @ shifts.T).astype(np.float64))
        kept = vectors[:, values > _WEAKEST * max(values[-1], 1e-300)].T
        fields = (kept.astype(np.float32) @ rows).reshape(len(kept), n_gaussians, DOF)
        return ModalFields(fields, kept, np.asarray(motion.freqs_hz, np.float64))

    def series(self, times_s: np.ndarray, phases: np.ndarray | None = None) -> np.ndarray:
        """[R, F]: the functions of time on a clock whose motion is ahead by phases [K], radians."""
        angles = 2 * np.pi * self.freqs_hz[:, None] * times_s
        if phases is not None:
            angles = angles + phases[:, None]
        return np.asarray(self.mixing @ np.concatenate([np.cos(angles), np.sin(angles)]))


def clock_phases(figures: Mapping[str, Any], name: str, freqs_hz: np.ndarray) -> np.ndarray | None:
    """[K] radians of camera `name` from a fit's figures, where every camera has a clock of its own; None elsewhere."""
    known = figures.get("clip_phases_deg", {}).get(name)
    if known is None:
        return None
    hz, degrees = np.array([float(k) for k in known]), np.array(list(known.values()))
    nearest = np.abs(freqs_hz[:, None] - hz).argmin(1)
    return np.radians(degrees[nearest])


@dataclass(frozen=True)
class SharedClock:
    """Views whose frames were taken at the same times: all of a synchronous capture, one of a clip."""

    name: str  # "" where there is one clock
    views: tuple[int, ...]
    times_s: np.ndarray  # [F] seconds
    sides: Sides | None  # `residuals.py`; None: of a flat capture
    series: np.ndarray  # [R, F] of the modal fields


@dataclass(frozen=True)
class Prepared:
    """A run or fit made ready by `prepare` or `prepare_fit`: `measure` takes it any number of times."""

    fit: MotionFit  # the scene and its motion
    folder: Path | None  # the run's; None: there is no run
    capture: Capture  # its pictures' cameras and times
    observations: Observations  # of the motion stage: views, clocks, pictures
    modal: ModalFields  # the motion as a few fields and their functions of time
    views: Sequence[MeasuredView]  # what was read of each view's pictures; none of a flat capture
    clocks: tuple[SharedClock, ...]  # views whose frames were taken at the same times
    seen: np.ndarray  # [N] blending weight, pixels, summed over the views
    notes: tuple[str, ...] = ()  # what this capture cannot tell, a line each
    # [S, F] functions of time that a moving camera cannot tell from its own motion
    slow: np.ndarray | None = None
    scale: Scale | None = None  # marked in the picture
    video: VideoFile | None = None  # that the one camera's pictures are of
    between: np.ndarray | None = None  # [T] bool: its frames that the codec predicts from both sides
    found: Found | None = None  # what the look at the one camera's pictures found

    @property
    def gaussians(self) -> Gaussians:
        """At rest."""
        return self.fit.gaussians

    @property
    def means(self) -> np.ndarray:
        """[N, 3] scene units."""
        return np.asarray(self.gaussians.means.numpy(), np.float64)

    @property
    def is_moving(self) -> bool:
        """Whether one moving camera took the pictures."""
        return self.observations.clock == Clock.moving


@dataclass(frozen=True)
class GreyPictures:
    """The luma of a video's frames in memory, or in a temporary file, without a dataset."""

    data: np.ndarray  # [F, H, W] uint8, or float32 of that range
    kinds: np.ndarray  # [F] of coded pictures: INTRA, FORWARD or BETWEEN of `capture.look.reading`

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.data.shape[1], self.data.shape[2]

    @property
    def maximum(self) -> int:
        """The value of white."""
        return 255

    def strips(self, rows: Sequence[int]) -> Strips:
        """Return opaque pictures, grey in all channels."""

        def strip(part: slice) -> np.ndarray:
            grey = self.data[list(rows), part, :, None].astype(np.uint8)
            return np.concatenate([grey, grey, grey, np.full_like(grey, 255)], -1)

        return strip


def zeros_in_room(shape: tuple[int, ...], folder: Path | None) -> np.ndarray:
    """Zeros [*shape] float32 to add to, beyond 1 GiB in a temporary file, of `folder` if that can be written."""
    where = folder if folder is not None and os.access(folder, os.W_OK) else None
    return mapped_zeros(shape, np.float32, where, IN_MEMORY)
