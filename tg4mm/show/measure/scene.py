"""The input of a measurement: the run or fit, its views and clocks, and the data read from its pictures."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture
from tg4mm.capture.look import LookSummary
from tg4mm.capture.pictures import Strips
from tg4mm.capture.scene import VideoFile
from tg4mm.core.choices import Clock
from tg4mm.core.memory import mapped_zeros
from tg4mm.core.regions import Scale
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.modes import ModalMotion, MotionFit
from tg4mm.fit.motion.observations import Observations
from tg4mm.show.measure.residuals import MeasuredView
from tg4mm.show.measure.stored_pass import RightHandSides

_WEAKEST = 1e-9  # of the strongest field's energy
IN_MEMORY = 1 << 30  # bytes of a pass through the pictures in memory; more lies in a temporary file


@dataclass(frozen=True)
class ModalFields:
    """The motion as real fields: Σ_r (mixing @ [Re g; Im g])_r fields[r] at a time, with the modes' gains g."""

    fields: np.ndarray  # [R, N, 6] float32, displacement (scene units) and rotation vector (radians)
    mixing: np.ndarray  # [R, 2K] float64
    freqs_hz: np.ndarray  # [K]

    @staticmethod
    def of(motion: ModalMotion | None, n_gaussians: int) -> "ModalFields":
        """Return the fields of a run's motion; none without motion."""
        if motion is None or not len(motion.freqs_hz):
            return ModalFields(np.zeros((0, n_gaussians, DOF), np.float32), np.zeros((0, 0)), np.zeros(0))
        rows = np.concatenate([motion.series.real, -motion.series.imag])  # [2K, R]
        values, vectors = np.linalg.eigh(rows @ motion.products(0) @ rows.T)
        kept = vectors[:, values > _WEAKEST * max(values[-1], 1e-300)].T
        fields = np.tensordot((kept @ rows).astype(np.float32), motion.fields, axes=1)
        return ModalFields(fields, kept, np.asarray(motion.freqs_hz, np.float64))

    def series(self, times_s: np.ndarray, phases: np.ndarray | None = None) -> np.ndarray:
        """Return the functions of time [R, F] on a clock whose motion is ahead by phases [K], radians."""
        angles = 2 * np.pi * self.freqs_hz[:, None] * times_s
        if phases is not None:
            angles = angles + phases[:, None]
        return np.asarray(self.mixing @ np.concatenate([np.cos(angles), np.sin(angles)]))


def clock_phases(figures: Mapping[str, Any], name: str, freqs_hz: np.ndarray) -> np.ndarray | None:
    """Return the phases [K] of camera `name` in radians from a fit's figures; None if cameras share a clock."""
    known = figures.get("clip_phases_deg", {}).get(name)
    if known is None:
        return None
    hz, degrees = np.array([float(k) for k in known]), np.array(list(known.values()))
    nearest = np.abs(freqs_hz[:, None] - hz).argmin(1)
    return np.radians(degrees[nearest])


@dataclass(frozen=True)
class SharedClock:
    """Views whose frames have the same times: all of a synchronous capture, one of a clip."""

    name: str  # "" where there is one clock
    views: tuple[int, ...]
    times_s: np.ndarray  # [F] seconds
    right_hand_sides: RightHandSides | None  # right-hand sides (`residuals.py`); None for a flat capture
    series: np.ndarray  # [R, F] of the modal fields


@dataclass(frozen=True)
class Prepared:
    """A run or fit prepared by `prepare` or `prepare_fit`, for any number of calls of `measure`."""

    fit: MotionFit  # the scene and its motion
    folder: Path | None  # the run's; None: there is no run
    capture: Capture  # its pictures' cameras and times
    observations: Observations  # of the motion stage: views, clocks, pictures
    modal: ModalFields  # the motion as a few fields and their functions of time
    views: Sequence[MeasuredView]  # data read from each view's pictures; none for a flat capture
    clocks: tuple[SharedClock, ...]  # views whose frames have the same times
    seen: np.ndarray  # [N] blending weight, pixels, summed over the views
    notes: tuple[str, ...] = ()  # limits of this capture, a line each
    slow: np.ndarray | None = None  # [S, F] functions of time that equal a moving camera's motion
    scale: Scale | None = None  # marked in the picture
    video: VideoFile | None = None  # of the one camera
    b_frames: np.ndarray | None = None  # [T] bool: its B-frames
    found: LookSummary | None = None  # result of the look at the one camera's pictures

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians at rest."""
        return self.fit.gaussians

    @property
    def means(self) -> np.ndarray:
        """Positions [N, 3] at rest, scene units."""
        return np.asarray(self.gaussians.means.numpy(), np.float64)

    @property
    def is_moving(self) -> bool:
        """Return whether one moving camera took the pictures."""
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
        """Return opaque pictures that are grey in all channels."""

        def strip(part: slice) -> np.ndarray:
            grey = self.data[list(rows), part, :, None].astype(np.uint8)
            return np.concatenate([grey, grey, grey, np.full_like(grey, 255)], -1)

        return strip


def zeros_on_disk(shape: tuple[int, ...], folder: Path | None) -> np.ndarray:
    """Return zeros [*shape] float32, beyond 1 GiB in a temporary file, in `folder` if that can be written."""
    where = folder if folder is not None and os.access(folder, os.W_OK) else None
    return mapped_zeros(shape, np.float32, where, IN_MEMORY)
