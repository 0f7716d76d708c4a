"""Pictures resampled to where things are at rest by cubic splines: a shaken camera's to one pose, others by a flow.

A camera that turns about its own centre by R moves its picture by the homography K R K⁻¹, whatever the depths are
(Hartley & Zisserman 2004, §8.4). So pictures can be rotated back by resampling alone, beyond what is linear in the
shift; `nuisance/projection.py` takes out what is left to first order. What moves before a fixed camera moves by its own
flow. What lies beyond the edge of a picture is taken to be as its edge.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np
from scipy.ndimage import gaussian_filter, spline_filter1d
from scipy.spatial.transform import Rotation

from tg4mm.capture.pictures import Pictures, Strips, over_white
from tg4mm.core.even_clock import later
from tg4mm.core.memory import mapped_zeros, release
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, arrays_of, gaussians_of
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.observations import Observations, PosedFrames, strips
from tg4mm.fit.motion.refine import refine_at_rest

_STEPS = 4
_STILL_PX = 0.003  # rms of a step below which another brings nothing
_RIDGE = 1e-6
_WINDOW_PX = 2.0  # standard deviation
_STILLEST = 0.25  # of the picture's slopes, by their squares
_ROBUST = 2.0  # times as far as these move counts half
_REFINING = 300  # iterations
_DECAY = 12  # pixels: 0.268¹² of a pixel's value is what a cubic spline's coefficients so far away owe to it
_UNMOVED_PX = 1e-3  # what moves by less stays as it is
_AT_ONCE = 8  # pictures
_WHITE = 65535


def homographies(K: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """[F, 3, 3]: K R K⁻¹ of rotation vectors [F, 3], radians, camera axes."""
    K = K.astype(np.float64)
    return K @ Rotation.from_rotvec(rotations).as_matrix() @ np.linalg.inv(K)


def stabilised(
    gaussians: Gaussians,
    observations: Observations,
    config: MotionConfig,
    device: str,
    checkpoint: Checkpoint,
    refines: bool = True,
) -> tuple[Gaussians, Observations, float]:
    """The scene at rest that registered pictures show, the observations with these, and the shake (pixels, rms).

    Where fixed cameras alone made the scene at rest, it was fitted to means of shaken pictures, which are blurred. With
    `refines` the Gaussians are then fitted to those of the registered pictures; their number and order stay.
    """

    def compute() -> Arrays:
        rotations = camera_rotations(observations)
        if not refines or not observations.is_whole or observations.is_flat:
            return {"rotations": rotations}
        means = mean_pictures(registered(observations, rotations))
        sharper = refine_at_rest(gaussians, observations.frames, means, _REFINING, config.seed, device)
        return {"rotations": rotations, **arrays_of(sharper)}

    kept = checkpoint("registration", compute)
    rotations = kept["rotations"]
    focal = max(float(f.K[0, 0]) for f in observations.frames)
    pixels = focal * float(np.sqrt((rotations[:, :2] ** 2).sum(1).mean()))
    scene = gaussians_of(kept) if "means" in kept else gaussians
    return scene, registered(observations, rotations), pixels


def registered(observations: Observations, rotations: np.ndarray) -> Observations:
    """The observations with every picture rotated back by its camera's rotation vector, [C, 3] in all."""
    back = np.tile(np.eye(3), (len(rotations), 1, 1))
    for frames in observations.frames:
        back[frames.rows] = homographies(frames.K, rotations[frames.rows])
    return replace(observations, pictures=RegisteredPictures(observations.pictures, back))


def camera_rotations(observations: Observations) -> np.ndarray:
    """[C, 3] rotation vectors of the pictures' cameras, radians, camera axes; of each fixed camera with mean 0.

    Gauss-Newton on the misfit to the camera's mean picture by the slopes of that, which is the same for all frames
    (inverse composition: Baker & Matthews 2004). The mean, blurred at first, is taken anew in every step. Exposure is
    fitted along. Places that move by themselves count little; what they still change the rotation by is small, and goes
    with the nuisance columns.
    """
    rotations = np.zeros((1 + max(int(f.rows.max()) for f in observations.frames), 3))
    with progress("registration", len(observations.frames), "cameras") as update:
        for v, frames in enumerate(observations.frames):
            rotations[frames.rows] = _rotations_of(observations, frames)
            update(v + 1)
    return rotations


def _rotations_of(observations: Observations, frames: PosedFrames) -> np.ndarray:
    """[F, 3] of one camera."""
    rows = frames.rows
    own = replace(observations, frames=[frames])
    rotations, exposures = np.zeros((len(rows), 3)), np.zeros((len(rows), 6))
    mean = mean_pictures(own)[0]
    weights = np.ones(mean.shape[:2], np.float32)
    for _ in range(_STEPS):
        everyone = np.zeros((int(rows.max()) + 1, 3))
        everyone[rows] = rotations
        n, mean, energy = _step(registered(own, everyone), mean, weights, exposures)
        rotations = (Rotation.from_rotvec(rotations) * Rotation.from_rotvec(n[:, 6:])).as_rotvec()
        rotations -= rotations.mean(0)
        exposures = n[:, :6]
        if float(frames.K[0, 0]) * np.sqrt((n[:, 6:] ** 2).sum(1).mean()) < _STILL_PX:
            break
        weights = _weights_of(mean, energy)
    return rotations


def _step(
    observations: Observations, mean: np.ndarray, weights: np.ndarray, exposures: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate exposure and rotation [F, 9] by which one camera's frames still differ from their mean.

    Also returns the mean [H, W, 3] and the energy [H, W], averaged over channels, of the changes that the exposures
    [F, 6] known so far leave unexplained.
    """
    frames = observations.frames[0]
    columns = np.concatenate([_exposure_columns(mean), _rotation_columns(mean, frames.K)])
    weighted = columns * weights[..., None]
    products = np.zeros((len(columns), len(frames.rows)))
    new, energy = np.empty_like(mean), np.empty(mean.shape[:2], np.float32)
    for rows, strip in strips(observations.pictures, frames):
        new[rows] = strip.mean(0)
        strip -= new[rows]
        products += weighted[:, rows].reshape(len(columns), -1) @ strip.reshape(len(strip), -1).T
        gains, offsets = exposures[:, None, None, :3], exposures[:, None, None, 3:]
        strip -= (gains * new[rows] + offsets).astype(np.float32)
        energy[rows] = np.einsum("fhwc,fhwc->hw", strip, strip) / 3
    gram = (weighted.reshape(len(columns), -1) @ columns.reshape(len(columns), -1).T).astype(np.float64)
    scale = np.sqrt(np.diag(gram)) + 1e-12
    gram = gram / np.outer(scale, scale) + _RIDGE * np.eye(len(columns))
    return (np.linalg.solve(gram, products / scale[:, None]) / scale[:, None]).T, new, energy


def _exposure_columns(mean: np.ndarray) -> np.ndarray:
    """[6, H, W, 3]: gain and offset of each channel."""
    out = np.zeros((6, *mean.shape), np.float32)
    for c in range(3):
        out[c, ..., c], out[3 + c, ..., c] = mean[..., c], 1
    return out


def _rotation_columns(mean: np.ndarray, K: np.ndarray) -> np.ndarray:
    """[3, H, W, 3]: what a rotation of the camera by one radian about its x, y, z changes."""
    down, right = np.gradient(mean, axis=(0, 1))
    height, width = mean.shape[:2]
    v, u = np.mgrid[:height, :width] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(K.astype(np.float64)).T
    out = np.empty((3, *mean.shape), np.float32)
    for k, axis in enumerate(np.eye(3)):
        moved = np.cross(axis, rays)
        flow = (moved[..., :2] - rays[..., :2] * moved[..., 2:]) @ K[:2, :2].T.astype(np.float64)
        out[k] = -(right * flow[..., :1] + down * flow[..., 1:])
    return out


def _weights_of(mean: np.ndarray, energy: np.ndarray) -> np.ndarray:
    """[H, W] float32: less where the picture about a pixel moves by more than where it moves least."""
    down, right = np.gradient(mean, axis=(0, 1))
    slopes = gaussian_filter((down**2 + right**2).mean(-1), _WINDOW_PX)
    moved = gaussian_filter(energy, _WINDOW_PX) / np.maximum(slopes, 1e-12)  # squared, about
    order = np.argsort(moved, axis=None)
    reached = np.cumsum(slopes.ravel()[order])
    stillest = float(moved.ravel()[order[np.searchsorted(reached, _STILLEST * reached[-1])]])
    return np.asarray(1 / (1 + moved / (_ROBUST**2 * max(stillest, 1e-12))), np.float32)


def mean_pictures(observations: Observations) -> np.ndarray:
    """[V, H, W, 3]: over time, of every camera."""
    pictures = observations.pictures
    return np.stack(
        [np.concatenate([s.mean(0) for _, s in strips(pictures, f)]) for f in observations.frames]
    )


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
        own = [self.place[int(row)] for row in rows]

        def strip(part: slice) -> np.ndarray:
            colours = self.data[own, part]
            release(self.data)
            return np.concatenate([colours, np.full((*colours.shape[:3], 1), _WHITE, np.uint16)], -1)

        return strip


def put_back(
    pictures: Pictures, frames: PosedFrames, flow: np.ndarray, functions: np.ndarray
) -> StoredPictures:
    """A fixed camera's F pictures in which what moves is put back to where it is at rest.

    At time t a pixel shows what the picture has at the pixel plus Σ_r functions[r](t) flow[r]: flow [R, H, W, 2] in
    pixels right and down, functions [R, F] at the times of the pictures' middle rows. Each row has its own time.
    """
    height, width = pictures.size
    out = mapped_zeros((len(frames.rows), height, width, 3), np.uint16)
    moves = np.tensordot(np.abs(functions).max(1), np.abs(flow).max(-1), 1) > _UNMOVED_PX
    rows, columns = (_reach(moves.any(axis)) for axis in (1, 0))
    by_row = _by_row(frames, functions, range(height)[rows], height)
    own = np.ascontiguousarray(flow[:, rows, columns], np.float32)
    with progress("pictures put back", len(frames.rows), "pictures") as update:
        for first in range(0, len(frames.rows), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            shown = over_white(pictures.strips(frames.rows[some].tolist())(slice(None)), pictures.maximum)
            if own.size:
                moved = np.einsum("krf,rkwc->fkwc", by_row[..., some], own, optimize=True)
                _resample_by(_spline(shown), moved, rows.start, columns.start, shown)
            out[some] = np.rint(np.clip(shown, 0, 1) * _WHITE)
            release(out)
            update(min(first + _AT_ONCE, len(frames.rows)))
    return StoredPictures(out, {int(row): k for k, row in enumerate(frames.rows)})


def _reach(some: np.ndarray) -> slice:
    """From the first to the last that is true."""
    where = np.flatnonzero(some)
    return slice(int(where[0]), int(where[-1]) + 1) if len(where) else slice(0, 0)


def _by_row(frames: PosedFrames, functions: np.ndarray, rows: range, height: int) -> np.ndarray:
    """[rows, R, F] float32: functions of time when each row of the pictures is read."""
    delays = [frames.readout_s * ((row + 0.5) / height - 0.5) for row in rows]
    each = [later(frames.times_s, functions, delay) for delay in delays]
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


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _resample(
    coefficients: np.ndarray, homographies: np.ndarray, first: int, top: int, height: int, out: np.ndarray
) -> None:
    """Fill the colours of out [F, rows, W, 4] from spline coefficients [F, rows', W, 3].

    The first row of `out` is row `top` of the picture; the coefficients begin at row `first`.
    """
    width = coefficients.shape[2]
    for f in numba.prange(len(out)):
        h = homographies[f]
        wx, wy = np.empty(4, np.float32), np.empty(4, np.float32)
        for i in range(out.shape[1]):
            for j in range(width):
                x, y = j + 0.5, top + i + 0.5
                scale = 1 / (h[2, 0] * x + h[2, 1] * y + h[2, 2])
                u = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) * scale - 0.5
                v = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) * scale - 0.5
                _sample(coefficients[f], u, v, first, height, width, wx, wy, out[f, i, j])


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _resample_by(coefficients: np.ndarray, moved: np.ndarray, top: int, left: int, out: np.ndarray) -> None:
    """A part of out [F, H, W, 3], whose corner is at row `top` and column `left`, by spline coefficients [F, H, W, 3].

    From where its pixels have moved to, by `moved` [F, rows, columns, 2].
    """
    height, width = out.shape[1:3]
    for f in numba.prange(len(out)):
        wx, wy = np.empty(4, np.float32), np.empty(4, np.float32)
        for i in range(moved.shape[1]):
            for j in range(moved.shape[2]):
                u, v = left + j + moved[f, i, j, 0], top + i + moved[f, i, j, 1]
                _sample(coefficients[f], u, v, 0, height, width, wx, wy, out[f, top + i, left + j])


@numba.njit(cache=True, error_model="numpy")
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


@numba.njit(cache=True, error_model="numpy")
def _mirrored(at: int, size: int) -> int:
    """The pixel within `size` that stands for one that may lie beyond the edge."""
    if at < 0:
        at = -at
    if at > size - 1:
        at = 2 * (size - 1) - at
    return at


@numba.njit(cache=True, error_model="numpy")
def _weights(t: float, out: np.ndarray) -> None:
    """Write the weights of the four coefficients about a place, t in 0..1 behind the second (cubic B-spline)."""
    s = 1 - t
    out[0] = s * s * s / 6
    out[1] = (4 - 6 * t * t + 3 * t * t * t) / 6
    out[2] = (4 - 6 * s * s + 3 * s * s * s) / 6
    out[3] = t * t * t / 6
