"""The state shared by all pages, scene, display settings and time, and its painter."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import CaptureError
from tg4mm.core.magnification import AS_CAPTURED, Magnification
from tg4mm.core.pictures.decode import to_bytes
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animator
from tg4mm.show.maps import pixel_sums
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_image
from tg4mm.show.view.colours import Colour, gaussian_colours
from tg4mm.show.view.scene import RunScene

Bands = tuple[tuple[float, float], ...]
_SH_0 = 0.28209479177387814  # the constant spherical harmonic: coefficient to colour


@dataclass(frozen=True)
class DisplaySettings:
    """The display settings apart from time and camera."""

    magnified: Magnification = AS_CAPTURED
    colour: Colour = Colour.picture
    beside: bool = False  # as captured and magnified, side by side
    mark: tuple[float, ...] | None = None  # [3] position of the clicked pixel, scene units


class SceneRenderer:
    """Draws a scene, one picture at a time, which uses all cores: calls from several threads wait for each other."""

    def __init__(self, scene: RunScene) -> None:
        self._scene = scene
        self._pose = animator(scene.gaussians, scene.motion)
        self._lock = threading.Lock()
        self._coloured: tuple[tuple[Colour, Bands], Tensor | None] = (Colour.picture, ()), None

    def paint(self, look: DisplaySettings, seconds: float, camera: Camera) -> np.ndarray:
        """Return the scene `seconds` into the capture over white, [height, width, 3] uint8."""
        with self._lock:
            return to_bytes(render_image(self._gaussians(look, seconds), *camera.view))

    def filmed(self, seconds: float, camera: Camera) -> np.ndarray | None:
        """Return the capture's picture from a camera, [height, width, 3] uint8; None if it does not exist."""
        try:
            return None if self._scene.filmed is None else self._scene.filmed.seen_by(camera, seconds)
        except (CaptureError, OSError):
            return None

    def pixel_weights(
        self, look: DisplaySettings, seconds: float, camera: Camera, x: int, y: int
    ) -> np.ndarray:
        """Return the blending weight α·T ([3DGS] Eq. (3)) of every Gaussian in pixel (x, y), [N] float64.

        They sum to the opacity. A weight is the pixel's gradient by the Gaussian's colour, from the rasteriser.
        """
        chosen = np.zeros((camera.height, camera.width, 1), np.float32)
        chosen[y, x] = 1
        with self._lock:
            return pixel_sums(self._gaussians(look, seconds), chosen, camera.viewmat, camera.K)[:, 0]

    def _gaussians(self, look: DisplaySettings, seconds: float) -> Gaussians:
        motion = self._scene.motion
        t = 0.0 if motion is None else seconds * motion.fps
        gaussians = self._pose(t, 0.0 if motion is None else look.magnified.ideal(motion.freqs_hz))
        sh = self._colours(look)
        return gaussians if sh is None else replace(gaussians, sh=sh)

    def _colours(self, look: DisplaySettings) -> Tensor | None:
        """Return spherical harmonics [N, 1, 3] of a colouring; the last ones are cached."""
        if self._coloured[0] != (key := (look.colour, look.magnified.limits)):
            rgb = gaussian_colours(self._scene, look.colour, look.magnified)
            sh = None if rgb is None else torch.tensor((rgb[:, None] - 0.5) / _SH_0, dtype=torch.float32)
            self._coloured = key, sh
        return self._coloured[1]


class Session:
    """A displayed scene.

    `revision` counts changes of the look; every change sets `changed`, for which the drawing loop waits.
    """

    def __init__(self, scene: RunScene, look: DisplaySettings, clock: PlaybackClock) -> None:
        self.scene = scene
        self.painter = SceneRenderer(scene)
        self.changed = threading.Event()
        self.revision = 0
        self._look, self._clock = look, clock
        self._lock = threading.Lock()

    @property
    def look(self) -> DisplaySettings:
        return self._look

    @property
    def clock(self) -> PlaybackClock:
        return self._clock

    def set_look(self, **changes: object) -> None:
        """Replace fields of the look."""
        with self._lock:
            self._look = replace(self._look, **changes)  # type: ignore[arg-type]
            self.revision += 1
        self.changed.set()

    @property
    def band(self) -> tuple[float, float] | None:
        """The magnified band in Hz, or None for all frequencies."""
        return next(iter(self._look.magnified.limits), None)

    def magnify(self, alpha: float) -> None:
        """Set another α in the same band."""
        self.set_look(magnified=self._look.magnified.times(alpha))

    def choose_band(self, band: tuple[float, float] | None) -> None:
        """Select another band with the same α; None: all frequencies."""
        limits = () if band is None else (band,)
        self.set_look(magnified=Magnification.of(self._look.magnified.alpha, *limits))

    def set_clock(self, change: Callable[[PlaybackClock, float], PlaybackClock]) -> None:
        """Replace the clock by `change(clock, now)`."""
        with self._lock:
            self._clock = change(self._clock, time.monotonic())
        self.changed.set()


@dataclass(frozen=True)
class PlaybackClock:
    """The playing time of the capture; moments `now` are seconds of one monotonic clock.

    Every change returns a new clock that continues at the same time.
    """

    duration: float  # seconds of the capture, T / fps; 0 for a still scene
    offset: float = 0.0  # seconds of the capture at `since`
    since: float = 0.0
    speed: float = 1.0  # seconds of the capture for each second
    playing: bool = False
    loop: bool = True

    def at(self, now: float) -> float:
        """Return the capture's time, 0 … duration; at the end it starts again with `loop`, otherwise it stays."""
        if not self.playing or self.duration <= 0:
            return self.offset
        position = self.offset + self.speed * (now - self.since)
        return position % self.duration if self.loop else min(position, self.duration)

    def running(self, now: float) -> bool:
        """Return whether time advances: playing, and not at the end."""
        return self.playing and self.duration > 0 and (self.loop or self.at(now) < self.duration)

    def changed(self, now: float, **changes: object) -> PlaybackClock:
        """Return a clock with another `speed`, `playing` or `loop` from now on; playing at the end starts at 0."""
        offset = self.at(now)
        if changes.get("playing") and not self.running(now) and offset >= self.duration:
            offset = 0.0
        return replace(self, offset=offset, since=now, **changes)  # type: ignore[arg-type]

    def sought(self, now: float, seconds: float) -> PlaybackClock:
        """Return a clock moved to `seconds`, limited to the capture, which keeps playing if it did."""
        return replace(self, offset=min(max(seconds, 0.0), self.duration), since=now)


def slow_enough(frequency_hz: float) -> float:
    """Return a round speed, at most 1, that leaves a cycle of `frequency_hz` eight of 24 pictures a second."""
    speeds = (1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01)
    return next((s for s in speeds if s * frequency_hz <= 3.0), speeds[-1])
