"""The picture of one open page, drawn again after a change of its contents or camera."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

from tg4mm.core.magnification import AS_CAPTURED
from tg4mm.show.render.cameras import Camera
from tg4mm.show.view.charts import ACCENT_RGB
from tg4mm.show.view.scene import camera_of
from tg4mm.show.view.session import DisplaySettings, SceneRenderer, Session

_MOVING, _STILL = 80, 95  # JPEG quality
NARROW = 600  # pixels of a phone, whose lower half the panel covers
_LETTER = 0.022  # of a picture's height
_BORDER = 90  # grey level between two pictures
_RING, _STROKE = 0.012, 1.5  # of the picture's shorter side; pixels
RATE = 30.0  # intended pictures a second
_COARSEST = 0.4  # of the canvas' sides; below, fewer pictures a second are better than fewer pixels
_FINEST = 2400  # pixels, longer side


@dataclass(frozen=True)
class Viewport:
    """The camera of a page and the size of its picture."""

    position: tuple[float, ...]  # [3] scene units
    wxyz: tuple[float, ...]  # [4] camera to world, OpenCV axes
    fov: float  # radians, from top to bottom
    width: int  # pixels
    height: int  # pixels

    def camera(self, size: tuple[int, int]) -> Camera:
        """Return the camera for a picture of `size` (width, height)."""
        rotation = Rotation.from_quat(np.roll(self.wxyz, -1)).as_matrix()
        return camera_of(np.array(self.position), rotation, self.fov, self.width / self.height, size)

    @property
    def can_be_drawn(self) -> bool:
        """Return whether it has a size and looks somewhere, unlike that of a hidden page."""
        numbers = np.array([*self.position, *self.wxyz, self.fov])
        turns = 0.5 < float(np.linalg.norm(self.wxyz)) < 2.0
        return (
            min(self.width, self.height) > 0
            and turns
            and 0 < self.fov < np.pi
            and np.abs(numbers).max() < 1e12
        )

    @property
    def holds_two(self) -> bool:
        """Return whether there is room for two pictures, which a phone lacks."""
        return self.width >= NARROW

    def halved(self) -> "Viewport":
        """Return the canvas of one of two pictures side by side."""
        return replace(self, width=self.width // 2)


def picture_of(
    painter: SceneRenderer, look: DisplaySettings, seconds: float, canvas: Viewport, size: tuple[int, int]
) -> np.ndarray:
    """Return a page's picture [H, W, 3] uint8 of `size` (w, h).

    With `look.beside` the captured scene comes first: the film's picture if a camera stood there, otherwise the model
    at α = 0, each with a caption.
    """
    if not (look.beside and canvas.holds_two and size[0] > 1):
        return painter.paint(look, seconds, canvas.camera(size))
    camera = canvas.halved().camera((size[0] // 2, size[1]))
    film = painter.filmed(seconds, camera)
    first = painter.paint(replace(look, magnified=AS_CAPTURED), seconds, camera) if film is None else film
    parts = [first, painter.paint(look, seconds, camera)]
    captions = (
        "model, not magnified" if film is None else "as filmed",
        f"{1 + look.magnified.alpha:g} times the motion",
    )
    for part, words in zip(parts, captions, strict=True):
        if look.mark is not None:
            _marked(part, camera, np.array(look.mark))
        _written(part, words)
    parts[0][:, -1] = _BORDER
    return np.pad(np.concatenate(parts, 1), ((0, 0), (0, size[0] % 2), (0, 0)), mode="edge")


def _written(picture: np.ndarray, words: str) -> None:
    """Write words into the upper left corner of picture [H, W, 3], at the size of a page's text."""
    height = max(12, round(_LETTER * picture.shape[0]))
    font = ImageFont.load_default(height)
    right, lower = (round(v) for v in font.getbbox(words)[2:])
    corner = picture[: lower + height, : right + height]
    label = Image.fromarray(np.ascontiguousarray(corner))
    ImageDraw.Draw(label).text(
        (height // 2, height // 2), words, "white", font, stroke_width=2, stroke_fill="black"
    )
    corner[:] = np.asarray(label)


def _marked(picture: np.ndarray, camera: Camera, point: np.ndarray) -> None:
    """Draw a ring around the point [3] into picture [H, W, 3]."""
    x, y, depth = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
    if depth > 0:
        rows, columns = np.ogrid[: camera.height, : camera.width]
        away = np.hypot(columns + 0.5 - x / depth, rows + 0.5 - y / depth)
        picture[np.abs(away - _RING * min(camera.height, camera.width)) < _STROKE] = [ACCENT_RGB]


class Screen:
    """Draws for one page. `send(picture [H, W, 3] uint8, JPEG quality)` puts a picture on it."""

    def __init__(self, session: Session, send: Callable[[np.ndarray, int], None]) -> None:
        self._session, self._send = session, send
        self._pace = Pace()
        self._shown: tuple[object, ...] | None = None
        self._fine = False
        self.size = (0, 0)  # of the last picture, pixels

    def refresh(self, canvas: Viewport, now: float) -> bool:
        """Draw and send the page's picture at `now` if it changed; returns whether it did."""
        session = self._session
        look, seconds = session.look, session.clock.at(now)
        wanted = (session.revision, seconds, canvas)
        fine = wanted == self._shown
        if fine and self._fine:
            return False
        size = (full_size if fine else self._pace.size)(canvas.width, canvas.height)
        begun = time.perf_counter()
        picture = picture_of(session.painter, look, seconds, canvas, size)
        self._send(picture, _STILL if fine else _MOVING)
        if not fine:
            self._pace = self._pace.after(time.perf_counter() - begun, size[0] * size[1])
        self._shown, self._fine, self.size = wanted, fine, size
        return True


@dataclass(frozen=True)
class Pace:
    """Pixels of the next picture, from the drawing times of the last ones."""

    pixels: float = 768.0 * 768.0

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return (width, height) of a picture of the canvas' shape, at most its size."""
        share = math.sqrt(self.pixels / (width * height))
        return _scaled(width, height, min(1.0, max(share, _COARSEST)))

    def after(self, seconds: float, drawn: int) -> "Pace":
        """Return the pace after a picture of `drawn` pixels took `seconds`; small deviations change nothing."""
        aim = 0.85 / RATE
        if 0.6 * aim < seconds <= aim:
            return self
        factor = min(max(aim / max(seconds, 1e-4), 0.6), 1.1)
        return replace(self, pixels=min(max(drawn * factor, 100.0**2), float(_FINEST) ** 2))


def full_size(width: int, height: int) -> tuple[int, int]:
    """Return (width, height) of a still picture: the canvas' size, its longer side at most 2400 pixels."""
    return _scaled(width, height, 1.0)


def _scaled(width: int, height: int, share: float) -> tuple[int, int]:
    share = min(share, _FINEST / max(width, height))
    return max(1, round(width * share)), max(1, round(height * share))
