"""Writes truth of the test views as files: optical flow, parts, occlusion, and tracks of points.

A pixel centre's scene point is known from the dataset's per-pixel truth, at rest its position less its displacement;
the nearest triangle of truth/motion.npz gives its part and its motion at every other time.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.truth_file import Truth, load_truth
from tg4mm.core.files import write_atomic, write_json
from tg4mm.core.pictures import exr
from tg4mm.core.progress import progress
from tg4mm.research.bench import BenchError
from tg4mm.research.evaluate.displacement import interpolate, nearest_on, sample_surface

VISIBLE, LEAVES, HIDDEN = 0, 128, 255  # in the pictures of occlusion
_NOTHING = 1e9  # depth from which a pixel is empty
_SAMPLES, _CANDIDATES, _AT_ONCE = 400_000, 16, 20_000
_BEHIND = 2e-3  # of its depth; a point farther behind the visible surface is hidden
_TRACKS = 1024  # points at most
_CHANNELS = ["Depth.V", *(f"{name}.{axis}" for name in ("Position", "Displacement") for axis in "XYZ")]


@dataclass(frozen=True)
class Followed:
    """Points on the surfaces at rest, and their motion."""

    part: np.ndarray  # [N] int, of `Truth.objects`
    phasors: np.ndarray  # [K, N, 3] complex128, scene units
    distance: np.ndarray  # [N] from the nearest triangle, scene units

    def displacement(self, gains: np.ndarray) -> np.ndarray:
        """Return the displacement [N, 3] for gains [K] of the modes."""
        return np.asarray(np.tensordot(gains, self.phasors, 1).real)

    def selected(self, rows: np.ndarray) -> "Followed":
        return Followed(self.part[rows], self.phasors[:, rows], self.distance[rows])


def follow(truth: Truth, points: np.ndarray) -> Followed:
    """Return the nearest surface points of all parts for points [N, 3], scene units, at rest."""
    objects = truth.objects
    starts = np.cumsum([0, *(len(o.rest) for o in objects)])
    rest = np.concatenate([o.rest for o in objects])
    faces = np.concatenate([o.faces + start for o, start in zip(objects, starts, strict=False)])
    modes = np.concatenate([o.modes for o in objects], axis=1)
    surface = sample_surface(rest, faces, _SAMPLES)
    part, distance = np.zeros(len(points), int), np.zeros(len(points))
    phasors = np.zeros((len(modes), len(points), 3), complex)
    for first in range(0, len(points), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        corners, weights, distance[some] = nearest_on(surface, rest, points[some], _CANDIDATES)
        phasors[:, some] = interpolate(modes, corners, weights)
        part[some] = np.searchsorted(starts, corners[:, 0], side="right") - 1
    return Followed(part, phasors, distance)


def write_truth(root: Path) -> list[Path]:
    """Write under `root`/truth flow/, parts/, occlusion/, parts.json and tracks.npz; see docs/conventions.md.

    They are of the test views at α = 0. Returns the folders and files. Raises BenchError without per-pixel truth,
    CaptureError for a damaged file.
    """
    capture = load_capture(root, split="test")
    truth = load_truth(root, capture.fps, capture.n_timesteps)
    views = _TestViews(root, capture, truth)
    every = np.concatenate([view.rest for view in views.seen.values()])
    followed = follow(truth, every)
    ends = np.cumsum([0, *(len(view.rest) for view in views.seen.values())])
    of = {key: followed.selected(np.arange(*ends[i : i + 2])) for i, key in enumerate(views.seen)}
    place = root / "truth"
    write_json(place / "parts.json", {str(i): o.name for i, o in enumerate(truth.objects, 1)})
    with progress("truth as files", len(capture), unit="pictures", brief=True) as update:
        for image in range(len(capture)):
            _write_picture(place, views, image, of[views.key[image]])
            update(image + 1)
    _write_tracks(place / "tracks.npz", views, of)
    return [place / name for name in ("flow", "parts", "occlusion", "parts.json", "tracks.npz")]


@dataclass(frozen=True)
class _View:
    depth: np.ndarray  # [H, W], planar z, scene units
    mask: np.ndarray  # [H, W] bool, pixels that are not empty
    rest: np.ndarray  # [N, 3] of the pixels in the mask, scene units
    now: np.ndarray  # [N, 3]


class _TestViews:
    """Per-pixel truth of the test views; timesteps with the same file are read once."""

    def __init__(self, root: Path, capture: Capture, truth: Truth) -> None:
        self.capture = capture
        turns = np.outer(truth.freqs_hz, np.arange(truth.n_timesteps)) / truth.fps
        self.gains: np.ndarray = np.exp(2j * np.pi * turns) if truth.gains is None else truth.gains  # [K, T]
        self.key: list[tuple[int, int]] = []
        self.seen: dict[tuple[int, int], _View] = {}
        for image, path in enumerate(capture.paths):
            file = root / "truth" / "test" / f"{capture.timesteps[image]:03d}" / f"{path.stem}.exr"
            if not file.is_file():
                raise BenchError(f"{file} does not exist: generate the dataset with --truth test")
            stat = file.stat()
            self.key.append((stat.st_dev, stat.st_ino))
            if self.key[-1] not in self.seen:
                self.seen[self.key[-1]] = _read(file, (capture.width, capture.height))
        if not any(len(view.rest) for view in self.seen.values()):
            raise BenchError(f"{root}: no test view sees anything")
        pairs = zip(capture.camera_ids.tolist(), capture.timesteps.tolist(), strict=True)
        self.at = {pair: image for image, pair in enumerate(pairs)}

    def view(self, image: int) -> _View:
        return self.seen[self.key[image]]

    def after(self, image: int) -> int | None:
        """Return the same camera's picture one timestep later."""
        capture = self.capture
        return self.at.get((int(capture.camera_ids[image]), int(capture.timesteps[image]) + 1))

    def projected(self, image: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixels [N, 2], x to the right and y down, centres at + 0.5, and depth [N]."""
        viewmat, k = (
            self.capture.viewmats[image].astype(np.float64),
            self.capture.Ks[image].astype(np.float64),
        )
        x = points @ viewmat[:3, :3].T + viewmat[:3, 3]
        across = x @ k.T
        return across[:, :2] / across[:, 2:], x[:, 2]

    def state(self, image: int, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return whether a picture shows points at these pixels, [N] uint8: VISIBLE, LEAVES or HIDDEN.

        Hidden points lie behind the farthest of the four pixel centres around them.
        """
        height, width = self.capture.height, self.capture.width
        inside = ((pixels >= 0) & (pixels <= (width, height))).all(1) & (depth > 0)
        low = np.floor(np.where(inside[:, None], pixels, 0) - 0.5).astype(int)
        x, y = (np.clip(low[:, i, None] + (0, 1), 0, n - 1) for i, n in enumerate((width, height)))
        farthest = self.view(image).depth[y[:, :, None], x[:, None, :]].max((1, 2))
        found = np.where(depth > farthest * (1 + _BEHIND), HIDDEN, VISIBLE)
        return np.where(inside, found, LEAVES).astype(np.uint8)


def _read(file: Path, size: tuple[int, int]) -> _View:
    found = exr.channels(file, _CHANNELS, size).astype(np.float64)
    depth, mask = found[..., 0], found[..., 0] < _NOTHING
    now = found[mask][:, 1:4]
    return _View(depth, mask, now - found[mask][:, 4:7], now)


def _write_picture(place: Path, views: _TestViews, image: int, followed: Followed) -> None:
    view, capture = views.view(image), views.capture
    name = Path("test") / f"{capture.timesteps[image]:03d}" / capture.paths[image].stem
    parts = np.zeros(view.mask.shape, np.uint8 if followed.part.max(initial=0) < 255 else np.uint16)
    parts[view.mask] = followed.part + 1
    _write_png(place / "parts" / name.with_suffix(".png"), parts)
    after = views.after(image)
    if after is None:
        return
    later = view.rest + followed.displacement(views.gains[:, capture.timesteps[after]])
    here, _ = views.projected(image, view.now)
    there, depth = views.projected(after, later)
    flow = np.zeros((*view.mask.shape, 2), np.float32)
    flow[view.mask] = there - here
    _write_flow(place / "flow" / name.with_suffix(".exr"), flow)
    occlusion = np.zeros(view.mask.shape, np.uint8)
    occlusion[view.mask] = views.state(after, there, depth)
    _write_png(place / "occlusion" / name.with_suffix(".png"), occlusion)


def _write_flow(path: Path, flow: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    channels = {f"Flow.{axis}": flow[..., i] for i, axis in enumerate("XY")}
    write_atomic(path, lambda temporary: exr.write(temporary, channels))


def _write_png(path: Path, numbers: np.ndarray) -> None:
    """Write integers of 8 or 16 bits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, lambda temporary: Image.fromarray(numbers).save(temporary, "PNG"))


def _write_tracks(path: Path, views: _TestViews, of: dict[tuple[int, int], Followed]) -> None:
    """Write points visible in the first pictures of all cameras, evenly thinned, for every camera and timestep."""
    capture = views.capture
    cameras = np.unique(capture.camera_ids)
    steps = np.unique(capture.timesteps)
    first = [views.at[int(camera), int(steps[0])] for camera in cameras]
    rest = np.concatenate([views.view(i).rest for i in first])
    keep = np.linspace(0, len(rest) - 1, min(_TRACKS, len(rest))).astype(int)
    phasors = np.concatenate([of[views.key[i]].phasors for i in first], axis=1)[:, keep]
    part = np.concatenate([of[views.key[i]].part for i in first])[keep]
    chosen = Followed(part, phasors, np.zeros(len(keep)))
    moved = np.stack([chosen.displacement(views.gains[:, t]) for t in steps])
    pixels = np.zeros((len(cameras), len(steps), len(keep), 2))
    visible = np.zeros(pixels.shape[:-1], bool)
    for image, c, t in _images(views, cameras, steps):
        pixels[c, t], depth = views.projected(image, rest[keep] + moved[t])
        visible[c, t] = views.state(image, pixels[c, t], depth) == VISIBLE
    arrays = {
        "points": rest[keep].astype(np.float32), "part": part + 1, "displacement": moved.astype(np.float32),
        "pixels": pixels.astype(np.float32), "visible": visible,
        "cameras": np.array([capture.paths[i].stem for i in first], np.str_),
    }  # fmt: skip
    write_atomic(path, lambda temporary: _savez(temporary, arrays))


def _savez(path: Path, arrays: dict[str, np.ndarray]) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _images(views: _TestViews, cameras: np.ndarray, steps: np.ndarray) -> Iterator[tuple[int, int, int]]:
    for c, camera in enumerate(cameras):
        for t, step in enumerate(steps):
            if (image := views.at.get((int(camera), int(step)))) is not None:
                yield image, c, t
