"""What the effects do to every picture of a record: the camera's true pose, and the gain of the light."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..cameras import Camera, CameraSetup, cameras_at, clock_offsets, films
from ..cameras.paths import Tremor, rotation_matrix
from .describe import Effects
from .warp import pixels_before

_KERNEL = 3  # pixels that the interpolation reaches beyond the picture


@dataclass(frozen=True)
class Record:
    """The training pictures of the cameras that film; each camera has a shake and a drift of its own.

    `size`: edge of the square pictures, pixels.
    """

    effects: Effects
    setup: CameraSetup
    size: int
    seed: int
    _turns: dict[int, np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    _gains: dict[int, np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    def shakes(self, split: str, camera: Camera) -> bool:
        """Whether pictures of this camera are taken with its pose disturbed."""
        return self.effects.shake_px > 0 and split == "train" and films(self.setup, camera)

    def turn(self, camera: Camera, timestep: int) -> np.ndarray:
        """Rotation vector [3] of a camera that shakes, radians, camera axes."""
        return np.asarray(self._all_turns(camera)[timestep])

    def true_camera(self, split: str, camera: Camera, timestep: int) -> Camera:
        """The camera as it really stood; the pose file says how it was meant to stand."""
        return turned(camera, self.turn(camera, timestep)) if self.shakes(split, camera) else camera

    def margin(self, camera: Camera) -> int:
        """Pixels that a rendering of a camera that shakes needs around the picture."""
        return math.ceil(largest_shift(camera, self.size, self._all_turns(camera))) + _KERNEL

    def gain(self, split: str, camera: Camera, timestep: int) -> np.ndarray | None:
        """Factors [3] on red, green and blue in linear light; None: 1."""
        if not (self.effects.gain and split == "train" and films(self.setup, camera)):
            return None
        if camera.index not in self._gains:
            self._gains[camera.index] = self._all_gains(camera)
        return np.asarray(self._gains[camera.index][timestep])

    def _all_turns(self, camera: Camera) -> np.ndarray:
        if camera.index not in self._turns:
            first = next(c for c in cameras_at(self.setup, 0)["train"] if c.index == camera.index)
            n, fps = self.setup.n_timesteps, self.setup.fps
            self._turns[camera.index] = turns(first, self.size, self.effects.shake_px, n, fps, self.seed)
        return self._turns[camera.index]

    def _all_gains(self, camera: Camera) -> np.ndarray:
        effects, n, fps = self.effects, self.setup.n_timesteps, self.setup.fps
        gains = np.ones((n, 3))
        if effects.exposure_drift:
            rng = np.random.default_rng([self.seed, 0xE805, camera.index])
            gains *= drift_gains(effects.exposure_drift, n, fps, rng)
        if effects.flicker:
            phase = np.random.default_rng([self.seed, 0xF11C]).uniform(0.0, 2 * np.pi)  # one lamp for all
            times_s = np.arange(n) / fps + clock_offsets(self.setup)[camera.index]
            gains *= flicker_gains(effects.flicker, effects.flicker_hz, times_s, phase)[:, None]
        return gains


_TONES = 3
_SLOWEST, _FASTEST = 0.3, 1.5  # cycles over the record
_LIMIT_HZ = 1.0  # a camera's own control is no faster


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
    """[T] from 0 to 1, both reached: a few cycles over the record at most, and none faster than 1 Hz."""
    seconds = n_timesteps / fps
    cycles = np.minimum(rng.uniform(_SLOWEST, _FASTEST, _TONES), _LIMIT_HZ * seconds)
    phases, sizes = rng.uniform(0.0, 2 * np.pi, _TONES), rng.uniform(0.5, 1.0, _TONES)
    turns = 2 * np.pi * np.outer(np.arange(n_timesteps) / n_timesteps, cycles)
    curve = np.sin(turns + phases) @ sizes
    return np.asarray((curve - curve.min()) / np.ptp(curve))


def flicker_gains(percent: float, hz: float, times_s: np.ndarray, phase: float) -> np.ndarray:
    """Gains [T] of light that flickers by `percent` peak to peak, at times on the scene's clock.

    The shutter is short and global: no bands run over the picture.
    """
    turns = (hz * np.asarray(times_s, np.float64)) % 1.0
    return 1.0 - 0.005 * percent * (1.0 - np.cos(2 * np.pi * turns + phase))


BAND_HZ = (1.0, 10.0)  # of hands and floors
_GRID = 16  # places per side of the picture at which shifts are measured


def turns(camera: Camera, size: int, shake_px: float, n_timesteps: int, fps: float, seed: int) -> np.ndarray:
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


def largest_shift(camera: Camera, size: int, vectors: np.ndarray) -> float:
    """How far any place of the picture goes at most, pixels."""
    return max(float(np.linalg.norm(_shift(camera, size, vector), axis=-1).max()) for vector in vectors)


def turned(camera: Camera, vector: np.ndarray) -> Camera:
    """The camera turned about its own centre by a rotation vector [3] in its own axes."""
    pose = camera.camera_to_world.copy()
    pose[:3, :3] = pose[:3, :3] @ rotation_matrix(vector)
    return replace(camera, camera_to_world=pose)


def _shift(camera: Camera, size: int, vector: np.ndarray) -> np.ndarray:
    """[G, 2] pixels, over a grid of the picture up to its edges."""
    edge = np.linspace(0.0, size, _GRID)
    places = np.stack(np.meshgrid(edge, edge), -1).reshape(-1, 2)
    return pixels_before(camera, size, vector, places) - places
