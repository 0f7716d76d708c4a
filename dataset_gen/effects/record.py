"""What the effects do to every picture of a record: the camera's true pose, and the gain of the light."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ..cameras import Camera, CameraSetup, cameras_at, clock_offsets, films
from .describe import Effects
from .gains import drift_gains, flicker_gains
from .shake import largest_shift, turned, turns

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
