"""`Capture`, the output of every reader: the images of a scene with cameras, times and kind (docs/conventions.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tg4mm.capture.cameras import relative_to
from tg4mm.core.choices import KINDS, Clock, Kind
from tg4mm.core.errors import CaptureError

if TYPE_CHECKING:
    from tg4mm.capture.sfm.undistort import Lens


# Of several fixed cameras: synchronous, their times are of one clock; independent, each has a clock of its own.
CLOCKS = (Clock.synchronous, Clock.independent)
FEWEST_FRAMES = (
    6  # of a fixed camera that shows motion: with fewer no frequency below half the frame rate is resolved
)
FEWEST_MOVING = 8  # of a moving camera
NEARLY_ALL = 0.9  # of the timesteps, for a camera to count as one that stayed put
TOLERANCE = 0.01  # of 1 / fps, that the median step of a camera's times may be off


@dataclass(frozen=True)
class SurfacePoints:
    """Points on the surfaces, an initialisation without SfM."""

    xyz: np.ndarray  # [M, 3] float32, or float64 where the file has that, scene units
    rgb: np.ndarray  # [M, 3] uint8, display-referred sRGB


@dataclass(frozen=True)
class Capture:
    """Images of one scene: C images, each from one camera at one timestep. Conventions: docs/conventions.md.

    Images are rows, in order of (timestep, file name; r_2 before r_10). `camera_ids` are equal for images
    that share pose and intrinsics exactly, so a camera that stays fixed over time is one id; they count from
    0 in order of first appearance, in each capture anew.
    """

    root: Path  # the dataset's folder; no image path leaves it
    split: str  # "train", "test" or "val"
    width: int  # pixels
    height: int  # pixels
    fps: float  # Hz; 0.0 if unknown, which only a capture of one timestep may be
    n_timesteps: int  # T
    viewmats: np.ndarray  # [C, 4, 4] float64, world-to-camera, OpenCV axes, rigid
    Ks: np.ndarray  # [C, 3, 3] float64, pixels, pixel centres at +0.5
    timesteps: np.ndarray  # [C] int64, 0 … T-1
    camera_ids: np.ndarray  # [C] int64
    paths: tuple[Path, ...]  # C image files
    unit_scale_m: float | None = None  # metres per scene unit; None if unknown
    points: SurfacePoints | None = None  # points on the surfaces with colours; None: the dataset has none
    scene: dict = field(default_factory=dict)  # scene.json as read, {} if absent
    kind: Kind = None  # type: ignore[assignment]  # inferred from the cameras if not given
    # of several fixed cameras: synchronous or independent; inferred from the times if not given
    clocks: str = ""
    readout_s: float = 0.0  # from a picture's first row to its last (rolling shutter); 0: all rows at once
    # [C] float64, seconds on the clock of the image's own camera, of its middle row; NaN for a picture of the scene at
    # rest without a time. t / fps if not given.
    times_s: np.ndarray = None  # type: ignore[assignment]
    # C, by which a picture as it is stored becomes a pinhole's when it is decoded; (): all are
    lenses: tuple[Lens | None, ...] = ()
    masks: tuple[
        Path | None, ...
    ] = ()  # C files, white where a picture counts (`pictures.py`); (): everywhere
    # [3] float64, in the dataset's coordinates: where those of viewmats and points begin. 0 but for a scene that lies
    # far from the dataset's own origin (`far_origin`), whose places float32 would not hold.
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        if self.times_s is None:
            object.__setattr__(self, "times_s", times_of_timesteps(self.timesteps, self.fps))
        kind = self.kind or kind_of_cameras(self.camera_ids, self.timesteps, self.n_timesteps)
        if kind not in KINDS:
            raise ValueError(f"kind is {self.kind!r}, expected one of {', '.join(KINDS)}")
        object.__setattr__(self, "kind", Kind(kind))
        c = len(self.paths)
        vectors = dict.fromkeys(("timesteps", "camera_ids", "times_s"), (c,))
        expected = {"viewmats": (c, 4, 4), "Ks": (c, 3, 3), **vectors}
        for name, shape in expected.items():
            actual = getattr(self, name).shape
            if actual != shape:
                raise ValueError(f"{name} has shape {actual}, expected {shape} for {c} images")

    def __len__(self) -> int:
        """C, the number of images."""
        return len(self.paths)

    def pinhole(self, i: int, image: np.ndarray) -> np.ndarray:
        """Return [H, W, 4] of picture i as it is decoded."""
        lens = self.lenses[i] if self.lenses else None
        return image if lens is None else lens.apply(image)

    @property
    def rows_s(self) -> float:
        """The readout that is taken into account: rows of a moving camera count as read at once."""
        return 0.0 if self.kind.moving else self.readout_s

    def moved_to(self, origin: np.ndarray) -> Capture:
        """The same capture in coordinates that begin at `origin` [3], which is in the dataset's coordinates."""
        shift = origin - self.origin
        if not shift.any():
            return self
        points = self.points
        if points is not None:
            points = replace(points, xyz=(points.xyz.astype(np.float64) - shift))
        return replace(self, viewmats=relative_to(self.viewmats, shift), points=points, origin=origin)

    def selected(self, rows: np.ndarray) -> Capture:
        """Return the capture with only the images `rows`, whole numbers; camera_ids are those of this capture."""
        return replace(
            self,
            viewmats=self.viewmats[rows],
            Ks=self.Ks[rows],
            timesteps=self.timesteps[rows],
            camera_ids=self.camera_ids[rows],
            times_s=self.times_s[rows],
            paths=tuple(self.paths[i] for i in rows),
            lenses=tuple(self.lenses[i] for i in rows) if self.lenses else (),
            masks=tuple(self.masks[i] for i in rows) if self.masks else (),
        )


def times_of_timesteps(timesteps: np.ndarray, fps: float) -> np.ndarray:
    """Return [C] float64, seconds: t / fps; zeros where the frame rate is not known (fps = 0)."""
    return timesteps / fps if fps else np.zeros(len(timesteps))


def kind_of_cameras(camera_ids: np.ndarray, timesteps: np.ndarray, n_timesteps: int) -> Kind:
    """The kind, from how many cameras have a picture at (nearly) every timestep. Never flat nor clips."""
    if n_timesteps == 1:
        return Kind.photos
    pairs = np.unique(np.stack([camera_ids, timesteps]), axis=1)
    counts = np.unique(pairs[0], return_counts=True)[1]
    fixed = int((counts >= max(2, NEARLY_ALL * n_timesteps)).sum())
    return next(kind for kind in Kind if kind.n_fixed == min(fixed, 2))


def check_times(
    where: str, times_s: np.ndarray, timesteps: np.ndarray, cameras: Sequence[str], fps: float
) -> None:
    """Raise CaptureError where a camera's times contradict fps: the median of their steps is not 1 / fps.

    where: the file that says fps. times_s [C] in seconds (NaN: not known), of pictures by `cameras` [C] at timesteps
    [C]. Single steps may differ: phones drop frames. Where no name comes back in a later timestep, as with frames that
    are numbered, the medians of the timesteps stand for a camera.
    """
    names, known = np.array(cameras), np.isfinite(times_s)
    checked = False
    for camera in dict.fromkeys(cameras):
        rows = np.flatnonzero((names == camera) & known)
        rows = rows[np.argsort(timesteps[rows], kind="stable")]
        if len(rows) < 2 or (np.diff(timesteps[rows]) == 0).any():
            continue
        _check_steps(where, f"camera {camera}", times_s[rows], timesteps[rows], fps)
        checked = True
    steps = np.unique(timesteps[known])
    if not checked and len(steps) > 1:
        medians = np.array([np.median(times_s[known & (timesteps == t)]) for t in steps])
        _check_steps(where, "the pictures", medians, steps, fps)


def _check_steps(where: str, whose: str, times_s: np.ndarray, timesteps: np.ndarray, fps: float) -> None:
    step = float(np.median(np.diff(times_s) / np.diff(timesteps)))
    if not abs(step * fps - 1) <= TOLERANCE:
        rate = f"{1 / step:.6g} Hz" if step > 0 else "no frame rate"
        raise CaptureError(
            f"{where}: fps is {fps:.6g}, but the times of {whose} step by {step:.6g} s ({rate}): "
            "correct fps, or the frames' time"
        )
