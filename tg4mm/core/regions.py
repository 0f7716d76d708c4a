"""Regions drawn on a picture and its scale, in a small JSON file that look, measure and process read.

    {"format": "tg4mm", "kind": "regions", "version": 1, "size": [480, 272],
     "regions": [{"name": "plate", "box": [150, 95, 330, 207]}, {"name": "bolt", "point": [240, 195, 8]},
                 {"name": "leg", "polygon": [[165, 205], [185, 205], [185, 217]], "camera": "cam_00"}],
     "lengths": [{"points": [[150, 95], [330, 95]], "metres": 0.36}],
     "rectangle": {"corners": [[150, 95], [330, 95], [330, 207], [150, 207]], "metres": [0.36, 0.224]}}

Pixels are from the picture's left and upper edge. `camera` names a view of a dataset that has several. Lengths scale a
surface that the camera faces; a rectangle (corners from its upper left one on, clockwise) also gives how a plane is
tilted (Hartley & Zisserman 2004, algorithm 4.1).
"""

from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.errors import RegionError, Tg4mmError
from tg4mm.core.files import write_json
from tg4mm.core.untrusted import read_formed
from tg4mm.core.values import POSITIVE, Just, Number

POINT_RADIUS = 12.0  # pixels around a point that says no other
_COUNT = {"box": 4, "point": 3}
_LARGEST = 65_536  # pixels, a side
_PIXEL = [Number(-_LARGEST, _LARGEST)]
_REGION = {"name": str, "box?": _PIXEL, "polygon?": [_PIXEL], "point?": _PIXEL, "camera?": str}
_FORM = {
    "format": Just("tg4mm"),
    "kind": Just("regions"),
    "version": Just(1),
    "size": [Number(1, _LARGEST, whole=True)],
    "source?": str,
    "regions": [_REGION],
    "lengths?": [{"points": [_PIXEL], "metres": POSITIVE}],
    "rectangle?": {"corners": [_PIXEL], "metres": [POSITIVE]},
}  # fmt: skip

Pixel = tuple[float, float]
_READ_PX = 0.5  # standard deviation of a place that a hand marks
_DISAGREE = 4.0  # deviations between two lengths


@dataclass(frozen=True)
class Scale:
    """The scale of a plane from marked lengths, or from a rectangle, which also gives its tilt."""

    lengths: tuple[tuple[Pixel, Pixel, float], ...] = ()  # both ends, metres
    corners: tuple[Pixel, ...] = ()  # of a rectangle, from its upper left one on, clockwise
    sides_m: Pixel = (0.0, 0.0)  # its width and height

    def __post_init__(self) -> None:
        for a, b, _ in self.lengths:
            if np.hypot(*np.subtract(a, b)) < 1:
                raise RegionError(f"a length's ends are one point, {a[0]:g}, {a[1]:g}")
        if self.corners:
            if len(self.corners) != 4:
                raise RegionError(f"a rectangle has {len(self.corners)} corners, expected 4")
            turns = np.roll(self.corners, -1, 0) - np.array(self.corners)
            after = np.roll(turns, -1, 0)
            if not (turns[:, 0] * after[:, 1] - turns[:, 1] * after[:, 0] > 1).all():
                raise RegionError(
                    "a rectangle's corners: expected upper left, upper right, lower right, lower left"
                )
        self._check_agree()

    def _check_agree(self) -> None:
        """Lengths must give one scale, and those on a rectangle's plane the rectangle's."""
        estimates = [
            (
                m / float(np.linalg.norm(self._between(a, b))),
                _READ_PX * 2**0.5 / float(np.hypot(*np.subtract(a, b))),
            )
            for a, b, m in self.lengths
        ]
        if self.corners:
            estimates.append((1.0, self.share))
        for (one, sure), (other, also) in combinations(estimates, 2):
            if abs(np.log(one / other)) > _DISAGREE * np.hypot(sure, also):
                unit = "times what the rectangle says" if self.corners else "mm per pixel"
                values = (one, other) if self.corners else (1e3 * one, 1e3 * other)
                raise RegionError(
                    f"two lengths disagree: {values[0]:.4g} and {values[1]:.4g} {unit}, by more than {_DISAGREE:g} × "
                    "what a mark is read to (half a pixel); of a tilted surface mark a rectangle"
                )

    def _between(self, a: Pixel, b: Pixel) -> np.ndarray:
        """Return [2] from a to b: metres by the rectangle, else pixels."""
        if not self.corners:
            return np.subtract(b, a)
        at = np.array([[*a, 1], [*b, 1]]) @ self._homography().T
        return np.asarray(np.diff(at[:, :2] / at[:, 2:], axis=0)[0])

    def _homography(self) -> np.ndarray:
        """Return [3, 3] from pixels to metres right and down on the plane, from the upper left corner."""
        (w, h), rows = self.sides_m, []
        for (x, y), (u, v) in zip(self.corners, ((0, 0), (w, 0), (w, h), (0, h)), strict=True):
            rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
        return np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)

    @property
    def share(self) -> float:
        """Standard deviation over the scale, by half a pixel at every mark."""
        if self.corners:
            return _READ_PX / float(
                np.mean(np.hypot(*(np.roll(self.corners, -1, 0) - np.array(self.corners)).T))
            )
        spans = [np.hypot(*np.subtract(a, b)) for a, b, _ in self.lengths]
        return _READ_PX * 2**0.5 / float(np.hypot.reduce(spans))

    def metres_at(self, at: Pixel) -> np.ndarray:
        """Return [2, 2] metres right and down on the plane for a pixel right (first column) and down, at a place.

        Raises RegionError beyond the plane's horizon.
        """
        if not self.corners:
            spans = np.array([np.hypot(*np.subtract(a, b)) for a, b, _ in self.lengths])
            metres = np.array([m for *_, m in self.lengths])
            return np.asarray(np.eye(2) * (metres @ spans) / (spans @ spans))
        h = self._homography()
        x, y, w = h @ [*at, 1.0]
        if w * (h[2] @ [*np.mean(self.corners, 0), 1.0]) <= 0:
            raise RegionError(
                f"pixel {at[0]:.0f}, {at[1]:.0f} lies beyond the horizon of the rectangle's plane"
            )
        return np.asarray((h[:2, :2] - np.outer([x / w, y / w], h[2, :2])) / w)

    @property
    def reference_m(self) -> float:
        """Return metres per pixel in the middle of the marks, the geometric mean of both directions."""
        places = self.corners or [p for a, b, _ in self.lengths for p in (a, b)]
        x, y = np.mean(places, 0)
        return float(np.linalg.det(self.metres_at((x, y))) ** 0.5)


@dataclass(frozen=True)
class Region:
    """A part of a picture. shape box: left, upper, right, lower; polygon: x, y of each corner; point: x, y, radius."""

    name: str
    shape: str
    values: tuple[float, ...]
    camera: str = ""

    def __post_init__(self) -> None:
        v, what = self.values, f"region {self.name!r}"
        if len(v) != _COUNT.get(self.shape, max(6, len(v) // 2 * 2)):
            raise RegionError(f"{what}: a {self.shape} of {len(v)} numbers; expected a box of 4 (left, upper, right, "
                              "lower), a point of 3 (x, y, radius), or a polygon of 3 corners or more")  # fmt: skip
        if not np.isfinite(v).all():
            raise RegionError(f"{what}: holds a number that is not finite")
        if self.shape == "box" and not (v[0] < v[2] and v[1] < v[3]):
            raise RegionError(f"{what}: box {list(v)} has no area; expected left, upper, right, lower")
        if self.shape == "point" and v[2] <= 0:
            raise RegionError(f"{what}: radius {v[2]:g} must be above 0")

    @property
    def corners(self) -> np.ndarray:
        """Return [P, 2] pixels: the outline as a polygon."""
        v = np.array(self.values)
        if self.shape == "box":
            return v[[0, 1, 2, 1, 2, 3, 0, 3]].reshape(4, 2)
        if self.shape == "polygon":
            return v.reshape(-1, 2)
        turns = np.arange(24) * 2 * np.pi / 24
        return np.asarray(v[:2] + v[2] * np.stack([np.cos(turns), np.sin(turns)], 1))

    @property
    def centre(self) -> Pixel:
        """Pixels, of the area. Raises RegionError where that is less than a pixel's."""
        p = self.corners - self.corners[0]
        q = np.roll(p, -1, 0)
        cross = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
        if abs(area := cross.sum() / 2) < 1:
            raise RegionError(
                f"region {self.name!r} has no area: its corners lie on one line, or in one pixel"
            )
        x, y = ((p + q) * cross[:, None]).sum(0) / (6 * area) + self.corners[0]
        return float(x), float(y)

    def mask(self, size: tuple[int, int]) -> np.ndarray:
        """Return [H, W] float32: 1 for the pixels of a picture of `size` (w, h) whose middle lies inside."""
        return inside(self.corners, size)


def inside(corners: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return [H, W] float32: 1 where a pixel's middle lies in the polygon [P, 2]."""
    x, y = np.arange(size[0]) + 0.5, np.arange(size[1])[:, None] + 0.5
    odd = np.zeros((size[1], size[0]), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, 0), strict=True):
        if y0 != y1:
            odd ^= ((y0 <= y) != (y1 <= y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return odd.astype(np.float32)


@dataclass(frozen=True)
class Regions:
    """The contents of a regions file."""

    size: tuple[int, int]  # of the picture, width and height
    regions: tuple[Region, ...] = ()
    scale: Scale | None = None
    source: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        names = [region.name.lower() for region in self.regions]
        if twice := [n for n in names if names.count(n) > 1]:
            raise RegionError(f"two regions are called {twice[0]!r}: give each a name of its own")
        for region in self.regions:
            low, high = region.corners.min(0), region.corners.max(0)
            if (high <= 0).any() or (low >= self.size).any():
                raise RegionError(f"region {region.name!r} lies outside the picture of {_size(self.size)}")
            _ = region.centre

    def __getitem__(self, name: str) -> Region:
        for region in self.regions:
            if region.name == name:
                return region
        known = ", ".join(r.name for r in self.regions) or "none"
        raise RegionError(f"no region {name!r}; there are: {known}")

    def check_size(self, size: tuple[int, int], what: object) -> None:
        """Raise RegionError if they were drawn on pictures of another size."""
        if tuple(size) != tuple(self.size):
            raise RegionError(f"regions are of pictures of {_size(self.size)}, those of {what} are {_size(size)}: draw "
                              f"them with tg4mm view {what}")  # fmt: skip


def read_regions(path: Path) -> Regions:
    """Read a regions file, written by `write_regions` or by hand. Raises RegionError with the file's name."""
    try:
        values = read_formed(path, _FORM)
        return _regions(values)
    except OSError as error:
        raise RegionError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, Tg4mmError) as error:
        raise RegionError(f"{path}: {error}") from None


def _check_known(entry: dict[str, Any], form: dict[str, Any], what: str) -> None:
    """A hand writes these files: an entry by another name would not count, and nobody would know."""
    known = [name.removesuffix("?") for name in form]
    if other := [name for name in entry if name not in known]:
        raise RegionError(f"{what}: unknown entry {other[0][:60]!r}, expected {', '.join(known)}")


def _regions(values: dict[str, Any]) -> Regions:
    _check_known(values, _FORM, "the file")
    scale = None
    if values.get("lengths") or values.get("rectangle"):
        box = values.get("rectangle") or {"corners": [], "metres": (0.0, 0.0)}
        lengths = []
        for one in values.get("lengths", []):
            first, last = map(_pixel, _of(2, one["points"], "a length's points"))
            lengths.append((first, last, float(one["metres"])))
        sides_m = _pixel(_of(2, box["metres"], "a rectangle's metres"))
        scale = Scale(tuple(lengths), tuple(map(_pixel, box["corners"])), sides_m)
    width, height = _of(2, values["size"], "size")
    regions = tuple(map(_region, values["regions"]))
    return Regions((int(width), int(height)), regions, scale, values.get("source", ""))


def _region(entry: dict[str, Any]) -> Region:
    _check_known(entry, _REGION, f"region {entry['name']!r}")
    shapes = [key for key in ("box", "polygon", "point") if key in entry]
    if len(shapes) != 1:
        raise RegionError(
            f"region {entry['name']!r} has {len(shapes)} shapes, expected a box, polygon or point"
        )
    numbers = entry[shapes[0]]
    if shapes[0] == "polygon":
        numbers = [x for corner in numbers for x in _pixel(corner)]
    elif shapes[0] == "point" and len(numbers) == 2:
        numbers = [*numbers, POINT_RADIUS]
    return Region(entry["name"], shapes[0], tuple(map(float, numbers)), entry.get("camera", ""))


def _of(count: int, values: list[Any], what: str) -> list[Any]:
    if len(values) != count:
        raise RegionError(f"{what}: {len(values)} given, expected {count}")
    return values


def _pixel(values: list[Any]) -> Pixel:
    x, y = _of(2, values, "a place in the picture")
    return float(x), float(y)


def write_regions(path: Path, regions: Regions) -> None:
    """Write a regions file for `read_regions`, atomically."""
    values: dict[str, Any] = {"format": "tg4mm", "kind": "regions", "version": 1, "size": list(regions.size)}
    values |= {"source": regions.source} if regions.source else {}
    values["regions"] = [
        {"name": r.name, r.shape: r.corners.tolist() if r.shape == "polygon" else list(r.values)}
        | ({"camera": r.camera} if r.camera else {})
        for r in regions.regions
    ]
    if (scale := regions.scale) is not None:
        values["lengths"] = [{"points": [list(a), list(b)], "metres": m} for a, b, m in scale.lengths]
        if scale.corners:
            values["rectangle"] = {"corners": list(map(list, scale.corners)), "metres": list(scale.sides_m)}
    write_json(path, values)


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]}×{size[1]} pixels"
