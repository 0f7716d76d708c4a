"""How far things move in the picture: displacements projected through a camera, per view and per mode."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.core.errors import CaptureError

from ..cameras import camera as pinhole
from ..errors import GenerateError
from .dataset import Dataset, MotionTruth, View, displacement_of, evenly

MOVING = 0.01  # of the set's largest displacement: what is displaced by more counts as moving
STILL = 1e-6  # of it: what is displaced by less stands still but for rounding
_MOST_TIMES = 16  # truth files read per view
_MOST_VERTICES = 20000
NOTHING = 1e9  # depth from which on a pixel sees nothing (the file has 1e10 there)


@dataclass(frozen=True)
class ViewMotion:
    """Motion in one view: the peak over time of every pixel (or vertex), summed up over those that move."""

    split: str
    name: str
    source: str  # "truth" (per-pixel files) or "vertices" (projected, hidden ones too)
    maximum: float  # pixels
    p95: float  # pixels
    median: float  # pixels
    still: float  # share of the seen pixels (of the vertices in the picture) that never move
    n: int  # pixels or vertices that move


@dataclass(frozen=True)
class Seen:
    """What the truth says of one view over time; timesteps that share a file are read once."""

    view: View  # at the first of the timesteps
    timesteps: tuple[int, ...]
    fixed: bool  # whether the camera stands still
    displacement: np.ndarray  # [n, H, W, 3] float32, scene units, NaN where nothing is seen
    pixels: np.ndarray  # [n, H, W] float32, projected, NaN where nothing is seen

    @property
    def peak(self) -> np.ndarray:
        """[H, W] largest displacement over time, scene units, NaN where nothing is ever seen."""
        return _nanmax(np.linalg.norm(self.displacement, axis=-1))

    @property
    def peak_pixels(self) -> np.ndarray:
        """[H, W] largest projected displacement over time, NaN where nothing is ever seen."""
        return _nanmax(self.pixels)


def project(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [..., 2] (NaN behind the camera) and depth [...] of world points [..., 3]."""
    pixels, depth = pinhole.project(points, view.camera_to_world, view.intrinsics)
    return np.where((depth > 1e-9)[..., None], pixels, np.nan), depth


def unproject(depth: np.ndarray, view: View) -> np.ndarray:
    """World points [H, W, 3] that pixel centres see at planar depths [H, W]."""
    return pinhole.unproject(depth, view.camera_to_world, view.intrinsics)


def projected_motion(position: np.ndarray, displacement: np.ndarray, view: View) -> np.ndarray:
    """Pixels [...] between where points are, [..., 3], and where they are at rest."""
    here, _ = project(position, view)
    rest, _ = project(position - displacement, view)
    return np.linalg.norm(here - rest, axis=-1)


def seen_motion(dataset: Dataset, views: list[View], most: int = _MOST_TIMES) -> Seen | None:
    """The truth of one camera's views, strongest timesteps first in choice; None if there is no file."""
    from ..truth import read_exr

    files: dict[tuple[int, int], tuple[View, Path]] = {}
    for view in views:
        path = dataset.truth_file(view)
        if path.is_file():
            stat = path.stat()
            files.setdefault((stat.st_dev, stat.st_ino), (view, path))
    if not files:
        return None
    chosen = sorted(evenly(list(files.values()), most), key=lambda found: found[0].timestep)
    displaced, moved = [], []
    for view, path in chosen:
        try:
            passes = read_exr(path, view.size)
        except CaptureError as error:
            raise GenerateError(str(error)) from None
        sees = passes["Depth"] < NOTHING
        position = unproject(np.where(sees, passes["Depth"], 1.0).astype(np.float64), view)
        displaced.append(np.where(sees[..., None], passes["Displacement"], np.nan))
        moved.append(np.where(sees, projected_motion(position, passes["Displacement"], view), np.nan))
    fixed = all(np.allclose(v.camera_to_world, views[0].camera_to_world, atol=1e-9) for v in views)
    return Seen(
        view=chosen[0][0], timesteps=tuple(view.timestep for view, _ in chosen), fixed=fixed,
        displacement=np.stack(displaced).astype(np.float32), pixels=np.stack(moved).astype(np.float32),
    )  # fmt: skip


def motion_from_truth(seen: Seen, amplitude: float) -> ViewMotion:
    """Motion of a view from its per-pixel truth; `amplitude` is the set's largest displacement."""
    peak = seen.peak
    return _summed_up(seen.view, "truth", peak[~np.isnan(peak)], seen.peak_pixels[~np.isnan(peak)], amplitude)


def motion_from_vertices(motion: MotionTruth, views: list[View], amplitude: float) -> ViewMotion:
    """Motion of one camera's views from the vertices inside the picture, whether hidden or not."""
    largest, pixels = [], []
    stride = max(1, sum(len(body.rest) for body in motion.bodies) // _MOST_VERTICES)
    used = evenly(views, 30)
    for body in motion.bodies:
        rest, modes = body.rest[::stride].astype(np.float64), body.modes[:, ::stride]
        size, moved = np.zeros(len(rest)), np.full(len(rest), np.nan)
        if not modes.any():  # most of a scene: no need to project it at every timestep
            moved = np.where(_inside(rest, used[0]), 0.0, np.nan)
        else:
            for view in used:
                displaced = displacement_of(modes, motion.gains[view.timestep])
                size = np.maximum(size, np.linalg.norm(displaced, axis=1))
                step = projected_motion(rest + displaced, displaced, view)
                moved = np.fmax(moved, np.where(_inside(rest, view), step, np.nan))
        seen = ~np.isnan(moved)
        largest.append(size[seen])
        pixels.append(moved[seen])
    return _summed_up(views[0], "vertices", np.concatenate(largest), np.concatenate(pixels), amplitude)


def _inside(points: np.ndarray, view: View) -> np.ndarray:
    pixel, depth = project(points, view)
    width, height = view.size
    with np.errstate(invalid="ignore"):
        return (depth > 1e-9) & ((pixel >= 0) & (pixel < (width, height))).all(-1)


def _summed_up(
    view: View, source: str, displaced: np.ndarray, pixels: np.ndarray, amplitude: float
) -> ViewMotion:
    moving = pixels[displaced > MOVING * amplitude]
    still = float(np.mean(displaced <= STILL * amplitude)) if displaced.size else 1.0
    if not moving.size:
        return ViewMotion(view.split, view.name, source, 0.0, 0.0, 0.0, still, 0)
    p95, median = np.percentile(moving, [95, 50])
    return ViewMotion(
        view.split, view.name, source, float(moving.max()), float(p95), float(median), still, moving.size
    )


def _nanmax(values: np.ndarray) -> np.ndarray:
    """Maximum over the first axis, NaN where there are only NaNs, without a warning."""
    least = np.where(np.isnan(values), -np.inf, values).max(axis=0)
    return np.where(np.isneginf(least), np.nan, least)
