"""The scale of a plane, pixels to metres, from lengths marked in the picture."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tg4mm.core.errors import RegionError

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
        told = [
            (
                m / float(np.linalg.norm(self._between(a, b))),
                _READ_PX * 2**0.5 / float(np.hypot(*np.subtract(a, b))),
            )
            for a, b, m in self.lengths
        ]
        if self.corners:
            told.append((1.0, self.share))
        for (one, sure), (other, also) in combinations(told, 2):
            if abs(np.log(one / other)) > _DISAGREE * np.hypot(sure, also):
                unit = "times what the rectangle says" if self.corners else "mm per pixel"
                values = (one, other) if self.corners else (1e3 * one, 1e3 * other)
                raise RegionError(
                    f"two lengths disagree: {values[0]:.4g} and {values[1]:.4g} {unit}, by more than {_DISAGREE:g} × "
                    "what a mark is read to (half a pixel); of a tilted surface mark a rectangle"
                )

    def _between(self, a: Pixel, b: Pixel) -> np.ndarray:
        """[2] from a to b: metres by the rectangle, else pixels."""
        if not self.corners:
            return np.subtract(b, a)
        at = np.array([[*a, 1], [*b, 1]]) @ self._homography().T
        return np.asarray(np.diff(at[:, :2] / at[:, 2:], axis=0)[0])

    def _homography(self) -> np.ndarray:
        """[3, 3] from pixels to metres right and down on the plane, from the upper left corner."""
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
        """[2, 2] metres right and down on the plane for a pixel right (first column) and down, at a place.

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
        """Metres per pixel in the middle of what was marked, the geometric mean of both directions."""
        places = self.corners or [p for a, b, _ in self.lengths for p in (a, b)]
        x, y = np.mean(places, 0)
        return float(np.linalg.det(self.metres_at((x, y))) ** 0.5)
