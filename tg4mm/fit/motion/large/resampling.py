"""Pictures resampled to where things are at rest by cubic splines: to a camera's common pose, or by a flow.

Beyond its edge a picture is continued by its edge.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import spline_filter1d

from tg4mm.capture.pictures import Pictures, Strips, over_white
from tg4mm.capture.tracking.row_times import row_delays
from tg4mm.core.memory import mapped_zeros, release
from tg4mm.core.progress import progress
from tg4mm.fit.motion.observations import PosedFrames
from tg4mm.fit.rasterize.kernels.compiled import part, shared

_DECAY = 12  # pixels: 0.268¹² of a pixel's value is what a cubic spline's coefficients so far away owe to it
_UNMOVED_PX = 1e-3  # smaller motion is not put back
_AT_ONCE = 8  # pictures
_WHITE = 65535


@dataclass(frozen=True)
class RegisteredPictures:
    """Pictures rotated back to their cameras' common pose as they are read: opaque, float32 in about 0..1."""

    pictures: Pictures
    homographies: np.ndarray  # [C, 3, 3]: from a pixel of the common pose to the picture's that shows it

    @property
    def size(self) -> tuple[int, int]:
        return self.pictures.size

    @property
    def maximum(self) -> int:
        return 1

    def strips(self, rows: Sequence[int]) -> Strips:
        raw = self.pictures.strips(rows)
        homographies = self.homographies[np.asarray(rows)]
        margin = _DECAY + 2 + _farthest(homographies, self.size)

        def registered(strip: slice) -> np.ndarray:
            height, width = self.size
            top, bottom, _ = strip.indices(height)
            first, last = max(top - margin, 0), min(bottom + margin, height)
            coefficients = _spline(over_white(raw(slice(first, last)), self.pictures.maximum))
            out = np.ones((len(homographies), bottom - top, width, 4), np.float32)
            _resample(coefficients, homographies, first, top, height, out)
            return out

        return registered


@dataclass(frozen=True)
class StoredPictures:
    """C opaque pictures of 16 bits, held by `mapped_zeros`."""

    data: np.ndarray  # [F, H, W, 3] uint16
    place: Mapping[int, int]  # of each of the C pictures among the F

    @property
    def size(self) -> tuple[int, int]:
        return self.data.shape[1], self.data.shape[2]

    @property
    def maximum(self) -> int:
        return _WHITE

    def strips(self, rows: Sequence[int]) -> Strips:
        places = [self.place[int(row)] for row in rows]

        def strip(part: slice) -> np.ndarray:
            colours = self.data[places, part]
            release(self.data)
            return np.concatenate([colours, np.full((*colours.shape[:3], 1), _WHITE, np.uint16)], -1)

        return strip


def put_back(
    pictures: Pictures, frames: PosedFrames, flow: np.ndarray, functions: np.ndarray
) -> StoredPictures:
    """Return a fixed camera's F pictures with moving parts resampled to their positions at rest.

    At time t a pixel shows what the picture has at the pixel plus Σ_r functions[r](t) flow[r]: flow [R, H, W, 2] in
    pixels right and down, functions [R, F] at the times of the pictures' middle rows. Each row has its own time.
    """
    height, width = pictures.size
    out = mapped_zeros((len(frames.rows), height, width, 3), np.uint16)
    moves = np.tensordot(np.abs(functions).max(1), np.abs(flow).max(-1), 1) > _UNMOVED_PX
    rows, columns = (_reach(moves.any(axis)) for axis in (1, 0))
    by_row = _by_row(frames, functions, range(height)[rows], height)
    inner = np.ascontiguousarray(flow[:, rows, columns], np.float32)
    with progress("pictures put back", len(frames.rows), "pictures") as update:
        for first in range(0, len(frames.rows), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            shown = over_white(pictures.strips(frames.rows[some].tolist())(slice(None)), pictures.maximum)
            if inner.size:
                moved = np.einsum("krf,rkwc->fkwc", by_row[..., some], inner, optimize=True)
                _resample_by(_spline(shown), moved, rows.start, columns.start, shown)
            out[some] = np.rint(np.clip(shown, 0, 1) * _WHITE)
            release(out)
            update(min(first + _AT_ONCE, len(frames.rows)))
    return StoredPictures(out, {int(row): k for k, row in enumerate(frames.rows)})


def _reach(some: np.ndarray) -> slice:
    """Return the slice from the first true entry to the last."""
    where = np.flatnonzero(some)
    return slice(int(where[0]), int(where[-1]) + 1) if len(where) else slice(0, 0)


def _by_row(frames: PosedFrames, functions: np.ndarray, rows: range, height: int) -> np.ndarray:
    """Return [rows, R, F] float32: functions of time when each row of the pictures is read."""
    delays = row_delays(frames.readout_s, rows, height)
    each = [frames.later(functions, delay) for delay in delays]
    return np.asarray(each, np.float32).reshape(len(rows), *functions.shape)


def _spline(pictures: np.ndarray) -> np.ndarray:
    """Cubic spline coefficients of [F, H, W, 3], mirrored about the centres of edge pixels."""
    for axis in (1, 2):
        pictures = spline_filter1d(pictures, 3, axis, np.float32, "mirror")
    return pictures


def _farthest(homographies: np.ndarray, size: tuple[int, int]) -> int:
    """Pixels that a corner goes up or down at most, rounded up."""
    height, width = size
    corners = np.array([[x, y, 1.0] for x in (0, width) for y in (0, height)])
    to = corners @ homographies.transpose(0, 2, 1)
    return int(np.ceil(np.abs(to[..., 1] / to[..., 2] - corners[:, 1]).max()))


@shared
def _resample(
    worker: int,
    workers: int,
    coefficients: np.ndarray,
    homographies: np.ndarray,
    first: int,
    top: int,
    height: int,
    out: np.ndarray,
) -> None:
    """Fill the colours of out [F, rows, W, 4] from spline coefficients [F, rows', W, 3].

    The first row of `out` is row `top` of the picture; the coefficients begin at row `first`.
    """
    width = coefficients.shape[2]
    for f in range(worker, len(out), workers):
        h = homographies[f]
        wx, wy = np.empty(4, np.float32), np.empty(4, np.float32)
        for i in range(out.shape[1]):
            for j in range(width):
                x, y = j + 0.5, top + i + 0.5
                scale = 1 / (h[2, 0] * x + h[2, 1] * y + h[2, 2])
                u = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) * scale - 0.5
                v = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) * scale - 0.5
                _sample(coefficients[f], u, v, first, height, width, wx, wy, out[f, i, j])


@shared
def _resample_by(
    worker: int,
    workers: int,
    coefficients: np.ndarray,
    moved: np.ndarray,
    top: int,
    left: int,
    out: np.ndarray,
) -> None:
    """A part of out [F, H, W, 3], whose corner is at row `top` and column `left`, by spline coefficients [F, H, W, 3].

    From where its pixels have moved to, by `moved` [F, rows, columns, 2].
    """
    height, width = out.shape[1:3]
    for f in range(worker, len(out), workers):
        wx, wy = np.empty(4, np.float32), np.empty(4, np.float32)
        for i in range(moved.shape[1]):
            for j in range(moved.shape[2]):
                u, v = left + j + moved[f, i, j, 0], top + i + moved[f, i, j, 1]
                _sample(coefficients[f], u, v, 0, height, width, wx, wy, out[f, top + i, left + j])


@part
def _sample(
    coefficients: np.ndarray,
    u: float,
    v: float,
    first: int,
    height: int,
    width: int,
    wx: np.ndarray,
    wy: np.ndarray,
    out: np.ndarray,
) -> None:
    """The colour [3] at column u and row v of a picture; whole numbers are centres of pixels.

    Its coefficients [rows, W, 3] begin at row `first`.
    """
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    column, row = int(u), int(v)
    _weights(u - column, wx)
    _weights(v - row, wy)
    r = g = b = np.float32(0)
    for a in range(4):
        source = min(max(_mirrored(row + a - 1, height) - first, 0), len(coefficients) - 1)
        for c in range(4):
            at = _mirrored(column + c - 1, width)
            w = wy[a] * wx[c]
            r += w * coefficients[source, at, 0]
            g += w * coefficients[source, at, 1]
            b += w * coefficients[source, at, 2]
    out[0], out[1], out[2] = r, g, b


@part
def _mirrored(at: int, size: int) -> int:
    """The pixel within `size` that stands for one that may lie beyond the edge."""
    if at < 0:
        at = -at
    if at > size - 1:
        at = 2 * (size - 1) - at
    return at


@part
def _weights(t: float, out: np.ndarray) -> None:
    """Write the weights of the four coefficients about a place, t in 0..1 behind the second (cubic B-spline)."""
    s = 1 - t
    out[0] = s * s * s / 6
    out[1] = (4 - 6 * t * t + 3 * t * t * t) / 6
    out[2] = (4 - 6 * s * s + 3 * s * s * s) / 6
    out[3] = t * t * t / 6
