"""Effects of real cameras on the pictures of a record: true pose, gain of the light, warp.

A turn about the camera's own centre maps the picture by a homography, whatever the depth. Interpolating the
rendered pixels would blur them, and more the farther a new pixel centre lies from an old one: a motion of its own.
So the scene is rendered at twice the resolution with a quarter of the samples, and a new pixel is the sum of fine
ones under the part of the camera's pixel filter that the fine pixels do not have yet. Cycles' Blackman-Harris
filter of setting w is a window 2 w pixels wide; the variance of a window goes with the square of its width, and
variances add up. So a window of √(3² − 1.5²) pixels follows one of 1.5 (fine pixels) to give one of 3 (the setting
1.5 of plain pictures).
"""

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ..cameras import CameraSetup, SceneCamera, cameras_at, clock_offsets, films
from ..cameras.paths import Tremor, rotation_matrix
from .options import Effects

BANDS = 16
MOMENTS = 5
FINENESS = 2  # fine pixels per pixel along an edge
FILTER_PX = 3.0  # full width of the filter of plain pictures (render.py: setting 1.5)
_WINDOW = math.sqrt(FILTER_PX**2 - (FILTER_PX / FINENESS) ** 2)  # pixels
_TAPS = math.ceil(0.5 * _WINDOW * FINENESS)  # fine pixels to either side
_BLACKMAN_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)
_KERNEL = 3  # pixels that the interpolation reaches beyond the picture
_TONES = 3
_LIMIT_HZ = 1.0  # a camera's own control is no faster
BAND_HZ = (1.0, 10.0)  # of hands and floors
_GRID = 16  # places per side of the picture at which shifts are measured
_SLOWEST, _FASTEST = 0.3, 1.5  # cycles over the record


def bands(size: int, readout_s: float) -> list[tuple[slice, float]]:
    """Rows from top to bottom, and by how many seconds they are read after the middle row."""
    edges = np.linspace(0, size, min(BANDS, size) + 1).astype(int).tolist()
    return [(slice(a, b), readout_s * ((a + b) / 2 / size - 0.5)) for a, b in pairwise(edges)]


def row_delays(size: int, readout_s: float) -> np.ndarray:
    """Return [size] seconds after the middle row."""
    return np.asarray(readout_s * ((np.arange(size) + 0.5) / size - 0.5))


def moments(shutter_s: float) -> list[tuple[float, float]]:
    """Return (share of the light, seconds after the middle) of the moments of an exposure; the shares sum to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(MOMENTS)
    return [(0.5 * w, 0.5 * shutter_s * x) for w, x in zip(weights.tolist(), nodes.tolist(), strict=True)]


def fine_size(size: int, margin: int) -> int:
    """Edge of the fine picture, for pictures of `size` pixels with `margin` more on every side."""
    return FINENESS * (size + 2 * margin)


def fine_camera(camera: SceneCamera, size: int, margin: int) -> SceneCamera:
    """The camera whose picture has a margin all around; same pose, same focal length per pixel."""
    wider = (size + 2 * margin) / size
    angle = 2.0 * math.atan(math.tan(0.5 * camera.angle_x) * wider)
    return replace(camera, angle_x=angle, shift=(camera.shift[0] / wider, camera.shift[1] / wider))


def pixels_before(camera: SceneCamera, size: int, vector: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Map `pixels` [..., 2] of a camera turned by a rotation vector [3] to pixels of the unturned camera.

    The vector is in camera axes (x right, y up, z back), radians; pixel centres lie at +0.5.
    """
    focal, centre = camera.focal(size), np.array(camera.principal_point(size, size))
    x, y = np.moveaxis((pixels - centre) / focal, -1, 0)
    rays = np.stack([x, -y, -np.ones_like(x)], -1) @ rotation_matrix(vector).T
    return centre + focal * np.stack([rays[..., 0], -rays[..., 1]], -1) / -rays[..., 2:]


def frame(fine: np.ndarray, camera: SceneCamera, size: int, margin: int, vector: np.ndarray) -> np.ndarray:
    """The picture [size, size, 4] of the camera turned by `vector` [3], from the fine one of `fine_camera`.

    Linear light, premultiplied, float32, as `fine` [F, F, 4] is. Raises ValueError if the margin is too small.
    """
    edge = fine_size(size, margin)
    if fine.shape != (edge, edge, 4):
        raise ValueError(f"the fine picture has shape {fine.shape}, expected {(edge, edge, 4)}")
    centres = np.arange(size) + 0.5
    places = np.stack(np.meshgrid(centres, centres), -1)
    sources = (pixels_before(camera, size, vector, places) + margin) * FINENESS - 0.5  # in fine pixels
    first = np.floor(sources).astype(int)
    if first.min() < _TAPS - 1 or first.max() + _TAPS >= edge:
        raise ValueError(f"a margin of {margin} pixels is too small for a turn by {vector.tolist()}")
    steps = np.arange(1 - _TAPS, 1 + _TAPS)
    weights = _window((sources - first)[..., None] - steps)  # [size, size, 2, K]
    weights /= weights.sum(-1, keepdims=True)
    total = np.zeros((size, size, 4))
    for i, down in enumerate(steps):
        for j, right in enumerate(steps):
            weight = weights[..., 1, i] * weights[..., 0, j]
            total += weight[..., None] * fine[first[..., 1] + down, first[..., 0] + right]
    return total.astype(np.float32)


def _window(offset: np.ndarray) -> np.ndarray:
    """The window at offsets in fine pixels."""
    phase = 2 * np.pi * (offset / (FINENESS * _WINDOW) + 0.5)
    a, b, c, d = _BLACKMAN_HARRIS
    value = a - b * np.cos(phase) + c * np.cos(2 * phase) - d * np.cos(3 * phase)
    return np.where(np.abs(offset) < 0.5 * FINENESS * _WINDOW, value, 0.0)


@dataclass(frozen=True)
class RecordingEffects:
    """The training pictures of the cameras that film; each camera has a shake and a drift of its own.

    `size`: edge of the square pictures, pixels.
    """

    effects: Effects
    setup: CameraSetup
    size: int
    seed: int
    _turns: dict[int, np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    _gains: dict[int, np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    def shakes(self, split: str, camera: SceneCamera) -> bool:
        """Return whether this camera's pose is disturbed."""
        return self.effects.shake_px > 0 and split == "train" and films(self.setup, camera)

    def turn(self, camera: SceneCamera, timestep: int) -> np.ndarray:
        """Rotation vector [3] of a camera that shakes, radians, camera axes."""
        return np.asarray(self._all_turns(camera)[timestep])

    def true_camera(self, split: str, camera: SceneCamera, timestep: int) -> SceneCamera:
        """The camera as it really stood; the pose file says how it was meant to stand."""
        return turned(camera, self.turn(camera, timestep)) if self.shakes(split, camera) else camera

    def margin(self, camera: SceneCamera) -> int:
        """Pixels that a rendering of a camera that shakes needs around the picture."""
        return math.ceil(largest_shift(camera, self.size, self._all_turns(camera))) + _KERNEL

    def gain(self, split: str, camera: SceneCamera, timestep: int) -> np.ndarray | None:
        """Factors [3] on red, green and blue in linear light; None: 1."""
        if not (self.effects.gain and split == "train" and films(self.setup, camera)):
            return None
        if camera.index not in self._gains:
            self._gains[camera.index] = self._all_gains(camera)
        return np.asarray(self._gains[camera.index][timestep])

    def row_gains(self, split: str, camera: SceneCamera, timestep: int) -> np.ndarray | None:
        """The same of every row where rows are read in turn and the light flickers: [size, 1, 3]."""
        gain, effects = self.gain(split, camera, timestep), self.effects
        if gain is None or not (effects.flicker and effects.readout_ms):
            return gain
        middle = timestep / self.setup.fps + clock_offsets(self.setup)[camera.index]
        delays = row_delays(self.size, effects.readout_ms / 1e3)
        light = flicker_gains(
            effects.flicker, effects.flicker_hz, middle + np.append(delays, 0.0), self._lamp_phase()
        )
        return np.asarray(gain * (light[:-1] / light[-1])[:, None, None])

    def _lamp_phase(self) -> float:
        return float(np.random.default_rng([self.seed, 0xF11C]).uniform(0.0, 2 * np.pi))

    def _all_turns(self, camera: SceneCamera) -> np.ndarray:
        if camera.index not in self._turns:
            first = next(c for c in cameras_at(self.setup, 0)["train"] if c.index == camera.index)
            n, fps = self.setup.n_timesteps, self.setup.fps
            self._turns[camera.index] = turns(first, self.size, self.effects.shake_px, n, fps, self.seed)
        return self._turns[camera.index]

    def _all_gains(self, camera: SceneCamera) -> np.ndarray:
        effects, n, fps = self.effects, self.setup.n_timesteps, self.setup.fps
        gains = np.ones((n, 3))
        if effects.exposure_drift:
            rng = np.random.default_rng([self.seed, 0xE805, camera.index])
            gains *= drift_gains(effects.exposure_drift, n, fps, rng)
        if effects.flicker:
            times_s = np.arange(n) / fps + clock_offsets(self.setup)[camera.index]
            gains *= flicker_gains(effects.flicker, effects.flicker_hz, times_s, self._lamp_phase())[:, None]
        return gains


def drift_gains(percent: float, n_timesteps: int, fps: float, rng: np.random.Generator) -> np.ndarray:
    """Gains [T, 3] of red, green and blue: exposure by `percent` peak to peak, red and blue by a third more each.

    They multiply linear light before the sensor sees it, and are never above 1: nothing clips that would not without.
    """
    exposure, red, blue = (slow_curve(n_timesteps, fps, rng) for _ in range(3))
    gains = np.repeat(1.0 - 0.01 * percent * exposure[:, None], 3, axis=1)
    gains[:, 0] *= 1.0 - 0.01 / 3 * percent * red
    gains[:, 2] *= 1.0 - 0.01 / 3 * percent * blue
    return gains


def slow_curve(n_timesteps: int, fps: float, rng: np.random.Generator) -> np.ndarray:
    """Return [T] from 0 to 1, both reached: a few cycles over the record at most, and none faster than 1 Hz."""
    seconds = n_timesteps / fps
    cycles = np.minimum(rng.uniform(_SLOWEST, _FASTEST, _TONES), _LIMIT_HZ * seconds)
    phases, sizes = rng.uniform(0.0, 2 * np.pi, _TONES), rng.uniform(0.5, 1.0, _TONES)
    turns = 2 * np.pi * np.outer(np.arange(n_timesteps) / n_timesteps, cycles)
    curve = np.sin(turns + phases) @ sizes
    return np.asarray((curve - curve.min()) / np.ptp(curve))


def flicker_gains(percent: float, hz: float, times_s: np.ndarray, phase: float) -> np.ndarray:
    """Gains [T] of light that flickers by `percent` peak to peak, at times on the scene's clock.

    The shutter is short. Without a readout it is global: no bands run over the picture.
    """
    turns = (hz * np.asarray(times_s, np.float64)) % 1.0
    return 1.0 - 0.005 * percent * (1.0 - np.cos(2 * np.pi * turns + phase))


def turns(
    camera: SceneCamera, size: int, shake_px: float, n_timesteps: int, fps: float, seed: int
) -> np.ndarray:
    """Rotation vectors [T, 3], radians, camera axes (x right, y up, z back), of mean 0 over the record.

    The rms over the record and the picture of the shift that they cause is `shake_px`, for a picture `size` wide.
    Tremor as that of hands, in 1 … 10 Hz: its power falls as 1/f². Every camera index has its own.
    """
    tremor = Tremor.of((seed, 0x54A6, camera.index), fps, BAND_HZ)
    vectors = np.array([tremor.at(t / fps)[1] for t in range(n_timesteps)])
    vectors -= vectors.mean(0)
    small = 1e-3 / camera.focal(size)  # shifts are linear in turns as small as these
    shifts = np.array([_shift(camera, size, vector) for vector in small * np.eye(3)]) / small
    rms = np.sqrt((np.tensordot(vectors, shifts, 1) ** 2).sum(-1).mean())
    return np.asarray(shake_px / rms * vectors)


def largest_shift(camera: SceneCamera, size: int, vectors: np.ndarray) -> float:
    """Return the largest shift anywhere in the picture, in pixels."""
    return max(float(np.linalg.norm(_shift(camera, size, vector), axis=-1).max()) for vector in vectors)


def turned(camera: SceneCamera, vector: np.ndarray) -> SceneCamera:
    """The camera turned about its own centre by a rotation vector [3] in its own axes."""
    pose = camera.camera_to_world.copy()
    pose[:3, :3] = pose[:3, :3] @ rotation_matrix(vector)
    return replace(camera, camera_to_world=pose)


def _shift(camera: SceneCamera, size: int, vector: np.ndarray) -> np.ndarray:
    """Return [G, 2] pixels, over a grid of the picture up to its edges."""
    edge = np.linspace(0.0, size, _GRID)
    places = np.stack(np.meshgrid(edge, edge), -1).reshape(-1, 2)
    return pixels_before(camera, size, vector, places) - places
