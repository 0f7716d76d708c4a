"""The dataset's cameras in a world of the usual kind, from the cameras and points of structure from motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tg4mm.capture.cameras import nearest_point_equations, optical_axes
from tg4mm.capture.sfm.clip import SWEEP, Clip, Sources, TimeWindow
from tg4mm.capture.sfm.dataset import Track
from tg4mm.capture.sfm.staging import StagedPicture, staged_name
from tg4mm.capture.sfm.survey import Survey
from tg4mm.capture.sfm.triangulate import SfmPoints, points_of
from tg4mm.capture.sfm.undistort import Key, Lens, lenses, quarter_turned
from tg4mm.core.choices import Kind
from tg4mm.core.errors import CaptureError

DISTANCE = 4.0  # scene units, mean distance of the cameras from the middle, NeRF-synthetic's
RATES_AGREE = 0.01  # relative, of cameras whose frames go into the same timesteps


@dataclass(frozen=True)
class FrameTimes:
    """Times of frames."""

    fps: float  # Hz
    times_s: dict[str, np.ndarray]  # of each clip, [T] seconds since its first frame


@dataclass(frozen=True)
class Similarity:
    """x ↦ scale · rotation (x − centre)."""

    rotation: np.ndarray  # [3, 3]
    scale: float
    centre: np.ndarray  # [3]

    def points(self, xyz: np.ndarray) -> np.ndarray:
        """Return [M, 3] points moved."""
        return self.scale * (xyz - self.centre) @ self.rotation.T

    def viewmats(self, viewmats: np.ndarray) -> np.ndarray:
        """Return [C, 4, 4] world-to-camera of the same cameras in the new world, lengths in new units."""
        moved = np.tile(np.eye(4), (len(viewmats), 1, 1))
        moved[:, :3, :3] = viewmats[:, :3, :3] @ self.rotation.T
        moved[:, :3, 3] = self.scale * (viewmats[:, :3, 3] + viewmats[:, :3, :3] @ self.centre)
        return moved


@dataclass(frozen=True)
class Placement:
    """The dataset's cameras and points, and how its world came from COLMAP's."""

    tracks: list[Track]
    points: SfmPoints
    world: Similarity


def clock_of(surveys: Sequence[Survey], fps: float | None) -> FrameTimes:
    """Return the recordings' times. fps: rate at which they were filmed; None: that of the containers.

    Raises CaptureError where nothing says it, or where recordings disagree.
    """
    clocks = {survey.name: survey.clock(fps) for survey in surveys}
    first, (rate, _) = next(iter(clocks.items()))
    for name, (other, _) in clocks.items():
        if abs(other / rate - 1) > RATES_AGREE:
            raise CaptureError(
                f"camera {name} has {other:.6g} frames per second, {first} has {rate:.6g}: a dataset has one frame rate"
            )
    return FrameTimes(rate, {name: times for name, (_, times) in clocks.items()})


def placed_tracks(
    kind: Kind,
    sources: Sources,
    taken: Sequence[StagedPicture],
    placed: dict[str, Any],
    model: Any,
    clock: FrameTimes | None,
    window: TimeWindow,
) -> Placement:
    """Tracks of all placed pictures, those of recordings first.

    taken: all pictures given to COLMAP; placed: pycolmap Images by name; model: the pycolmap Reconstruction.
    """
    shots = [shot for shot in taken if staged_name(shot) in placed]
    images = [placed[staged_name(shot)] for shot in shots]
    viewmats = np.tile(np.eye(4), (len(images), 1, 1))
    viewmats[:, :3] = [image.cam_from_world().matrix() for image in images]
    keys = _keys(shots, [image.camera_id for image in images], model)
    rest = {key for shot, key in zip(shots, keys, strict=True) if shot.clip == SWEEP}
    main = {key for shot, key in zip(shots, keys, strict=True) if shot.clip != SWEEP}
    lens = lenses({key: model.cameras[key[0]] for key in main | rest}, fitted=rest - main)
    turned = np.stack([lens[key].viewmat(viewmat) for key, viewmat in zip(keys, viewmats, strict=True)])
    upright = np.stack([quarter_turned(v, shot.turns) for shot, v in zip(shots, viewmats, strict=True)])
    found = points_of(model)
    xyz = found.xyz.astype(np.float64)
    world = world_of(upright, xyz)
    cameras = _Cameras(shots, [lens[key] for key in keys], world.viewmats(turned))
    moved = SfmPoints(world.points(xyz).astype(np.float32), found.rgb, found.errors_px, found.n_views)
    if clock is None:
        tracks = cameras.photographs()
    elif kind.moving:
        tracks = [cameras.moving(sources.clips[0], clock)]
    else:
        tracks = [
            track for clip in sources.clips for track in cameras.fixed(clip, clock, window, kind.holds_out)
        ]
    return Placement(tracks + ([] if clock is None else cameras.sweep()), moved, world)


def _keys(shots: Sequence[StagedPicture], camera_ids: Sequence[int], model: Any) -> list[Key]:
    """Camera and turn of each picture: upright where that lies as most pictures do, turned to lie so where not."""
    sizes = [(model.cameras[i].width, model.cameras[i].height) for i in camera_ids]
    wide = [w >= h for w, h in (shot.upright(size) for shot, size in zip(shots, sizes, strict=True))]
    main = [is_wide for shot, is_wide in zip(shots, wide, strict=True) if shot.clip != SWEEP]
    most = 2 * sum(main) >= len(main)
    return [
        (i, shot.turns if is_wide == most else 1 - shot.turns % 2)
        for i, shot, is_wide in zip(camera_ids, shots, wide, strict=True)
    ]


@dataclass(frozen=True)
class _Cameras:
    """Placed pictures with their lenses and poses, row by row."""

    shots: list[StagedPicture]
    lenses: list[Lens]
    viewmats: np.ndarray  # [P, 4, 4]

    def of(self, clip: str) -> list[int]:
        return [i for i, shot in enumerate(self.shots) if shot.clip == clip]

    def photographs(self) -> list[Track]:
        stems = [shot.path.stem for shot in self.shots]
        return [
            self._single(i, shot.path.name.replace(".", "_") if stems.count(stem) > 1 else stem, True)
            for i, (shot, stem) in enumerate(zip(self.shots, stems, strict=True))
        ]

    def sweep(self) -> list[Track]:
        return [self._single(i, f"{SWEEP}_{self.shots[i].path.stem}", False) for i in self.of(SWEEP)]

    def fixed(self, clip: Clip, clock: FrameTimes, window: TimeWindow, may_test: bool) -> list[Track]:
        times_s = clock.times_s[clip.name]
        return [
            Track(
                clip.name,
                clip,
                self.lenses[i],
                np.tile(self.viewmats[i], (len(times_s), 1, 1)),
                times_s,
                window=window,
                may_test=may_test,
            )
            for i in self.of(clip.name)
        ]

    def moving(self, clip: Clip, clock: FrameTimes) -> Track:
        """A picture at every timestep, frames that could not be placed left out."""
        rows = self.of(clip.name)
        frames = Clip(clip.name, self.shots[rows[0]].path.parent, tuple(self.shots[i].path for i in rows))
        taken = np.array([self.shots[i].index for i in rows])
        return Track(
            clip.name, frames, self.lenses[rows[0]], self.viewmats[rows], clock.times_s[clip.name][taken]
        )

    def _single(self, i: int, name: str, may_test: bool) -> Track:
        path = self.shots[i].path
        return Track(
            name,
            Clip(path.stem, path.parent, (path,)),
            self.lenses[i],
            self.viewmats[i : i + 1],
            may_test=may_test,
        )


def world_of(viewmats: np.ndarray, xyz: np.ndarray) -> Similarity:
    """The similarity that brings cameras viewmats [C, 4, 4] and points [M, 3] to a world of the usual kind.

    Up is what the pictures' rows are level to. The middle is the point nearest to all optical axes, or that of the
    points where the axes do not meet before the cameras. Then the first camera looks along +y, seen from above.
    """
    up = up_axis(viewmats)
    centres, axes = optical_axes(viewmats)
    ahead = axes[0] - (axes[0] @ up) * up
    if np.linalg.norm(ahead) < 1e-3:  # straight down: the top of the picture is ahead
        ahead = -viewmats[0, 1, :3] + (viewmats[0, 1, :3] @ up) * up
    ahead /= np.linalg.norm(ahead)
    rotation = np.stack([np.cross(ahead, up), ahead, up])
    middle = _middle(centres, axes, xyz)
    distance = float(np.linalg.norm(centres - middle, axis=1).mean())
    return Similarity(rotation, DISTANCE / max(distance, 1e-12), middle)


def up_axis(viewmats: np.ndarray) -> np.ndarray:
    """Return [3] unit vector: across to the cameras' horizontal axes (least squares), on the side of their mean up.

    Pictures are mostly taken level, so their rows are horizontal, however far the cameras look down. Where all rows
    point one way (cameras side by side), across is undetermined: then it is the mean up itself.
    """
    mean_up = -viewmats[:, 1, :3].mean(axis=0)
    _, size, directions = np.linalg.svd(viewmats[:, 0, :3])
    up = directions[2] * np.sign(directions[2] @ mean_up or 1.0)
    length = np.linalg.norm(mean_up)
    if size[1] < 0.1 * size[0] or (len(size) > 2 and size[2] > 0.5 * size[1]) or up @ mean_up < 0.3 * length:
        return mean_up / max(length, 1e-12) if length > 1e-6 else up
    return up


def _middle(centres: np.ndarray, axes: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    A, b = nearest_point_equations(centres, axes)
    if np.linalg.cond(A) < 1e3:
        middle = np.linalg.solve(A, b)
        if ((middle - centres) * axes).sum(axis=1).min() > 0:
            return middle
    return np.median(xyz, axis=0) if len(xyz) else centres.mean(axis=0) + axes.mean(axis=0)
