"""One picture of the scene: magnified, at a moment, coloured, from a camera. Drawn by tg4mm's own rasteriser."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numba
import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import CaptureError
from tg4mm.core.magnification import AS_CAPTURED, Magnification
from tg4mm.core.pictures.frames import to_bytes
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animator
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_image
from tg4mm.show.view.colours import Colour, gaussian_colours
from tg4mm.show.view.scene import RunScene
from tg4mm.show.weights import pixel_sums

Bands = tuple[tuple[float, float], ...]
_MOMENT = 0.02  # seconds: enough for a thread that waits for the painter to be let in
_SH_0 = 0.28209479177387814  # the constant spherical harmonic: coefficient to colour


@dataclass(frozen=True)
class Look:
    """The display settings apart from time and camera."""

    magnified: Magnification = AS_CAPTURED
    colour: Colour = Colour.picture
    beside: bool = False  # as captured and magnified, side by side
    mark: tuple[float, ...] | None = None  # [3] scene units, of the clicked pixel, where they are


class Painter:
    """Draws a scene. One picture at a time: calls from several threads wait for each other.

    numba's kernels take all cores anyway, and not all of its threading layers may be entered twice.
    """

    def __init__(self, scene: RunScene) -> None:
        self._scene = scene
        self._pose = animator(scene.gaussians, scene.motion, packed=True)
        self._lock = threading.Lock()
        self._coloured: tuple[tuple[Colour, Bands], Tensor | None] = (Colour.picture, ()), None

    @contextmanager
    def beside(self) -> Iterator[Callable[[], None]]:
        """Within it other kernels of numba may run beside the painter's.

        Where numba's threads do not allow that, pictures wait, but for a moment whenever the function that it yields is
        called.
        """
        if numba.threading_layer() != "workqueue":
            yield lambda: None
            return

        def let_paint() -> None:
            self._lock.release()
            time.sleep(_MOMENT)
            self._lock.acquire()

        with self._lock:
            yield let_paint

    def paint(self, look: Look, seconds: float, camera: Camera) -> np.ndarray:
        """[height, width, 3] uint8: the scene `seconds` into the capture over white."""
        with self._lock:
            gaussians = self._gaussians(look, seconds)
            size = (camera.width, camera.height)
            return to_bytes(render_image(gaussians, camera.viewmat, camera.K, *size))

    def filmed(self, seconds: float, camera: Camera) -> np.ndarray | None:
        """[height, width, 3] uint8: the capture's own picture from there; None where there is none, or it is gone."""
        try:
            return None if self._scene.filmed is None else self._scene.filmed.seen_by(camera, seconds)
        except (CaptureError, OSError):
            return None

    def pixel_weights(self, look: Look, seconds: float, camera: Camera, x: int, y: int) -> np.ndarray:
        """[N] float64: blending weight α·T ([3DGS] Eq. (3)) of every Gaussian in pixel (x, y); they sum to its opacity.

        It is the gradient of the pixel by the Gaussian's colour, which the rasteriser gives exactly.
        """
        chosen = np.zeros((camera.height, camera.width, 1), np.float32)
        chosen[y, x] = 1
        with self._lock:
            return pixel_sums(self._gaussians(look, seconds), chosen, camera.viewmat, camera.K)[:, 0]

    def _gaussians(self, look: Look, seconds: float) -> Gaussians:
        motion = self._scene.motion
        t = 0.0 if motion is None else seconds * motion.fps
        gaussians = self._pose(t, 0.0 if motion is None else look.magnified.ideal(motion.freqs_hz))
        sh = self._colours(look)
        return gaussians if sh is None else replace(gaussians, sh=sh)

    def _colours(self, look: Look) -> Tensor | None:
        """[N, 1, 3] spherical harmonics of a colouring; of the last one they are kept."""
        if self._coloured[0] != (key := (look.colour, look.magnified.limits)):
            rgb = gaussian_colours(self._scene, look.colour, look.magnified)
            sh = None if rgb is None else torch.tensor((rgb[:, None] - 0.5) / _SH_0, dtype=torch.float32)
            self._coloured = key, sh
        return self._coloured[1]
