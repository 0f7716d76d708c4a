"""The capture's own pictures, as a page sees them while its camera stands where a camera of the capture stood."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from tg4mm.capture import Capture
from tg4mm.capture.pictures import FilePictures
from tg4mm.core.pictures.frames import to_bytes
from tg4mm.show.render.cameras import Camera

_SAME_PLACE = 1e-3  # of the distance to what is looked at


class Filmed:
    """Pictures of fixed cameras on the common clock; a clip's own clock says nothing about the others."""

    def __init__(self, capture: Capture, depth: float) -> None:
        """depth: scene units, of what the cameras look at."""
        self._capture, self._pictures = capture, FilePictures(capture)
        ids, timed = capture.camera_ids, np.isfinite(capture.times_s)
        several = [np.flatnonzero((ids == k) & timed) for k in np.unique(ids)]
        self._rows: Sequence[np.ndarray] = [
            rows for rows in several if len(rows) > 1 and capture.clocks != "independent"
        ]
        self._near = _SAME_PLACE * depth

    def seen_by(self, camera: Camera, seconds: float) -> np.ndarray | None:
        """[height, width, 3] uint8: the picture nearest to that moment, white beyond its edges.

        None where no camera stood at this place. A turned or zoomed camera sees it turned and zoomed, as a rotation in
        place is a homography (Hartley & Zisserman, §8.4.2).
        """
        for rows in self._rows:
            viewmat, K = self._capture.viewmats[rows[0]], self._capture.Ks[rows[0]]
            position = -viewmat[:3, :3].T @ viewmat[:3, 3]
            if np.linalg.norm(position - camera.position) < self._near:
                row = int(rows[np.argmin(np.abs(self._capture.times_s[rows] - seconds))])
                turned = K @ viewmat[:3, :3] @ camera.viewmat[:3, :3].T @ np.linalg.inv(camera.K)
                return _warped(to_bytes(self._pictures.rgb(row)), turned, (camera.width, camera.height))
        return None


def _warped(picture: np.ndarray, homography: np.ndarray, size: tuple[int, int]) -> np.ndarray | None:
    """[h, w, 3] of a picture [H, W, 3]; homography [3, 3]: from pixels (x, y, 1) of the result to its own."""
    if homography[2, 2] <= 0:  # turned away
        return None
    factors = (homography / homography[2, 2]).ravel()[:8].tolist()
    seen = Image.fromarray(picture).transform(
        size, Image.Transform.PERSPECTIVE, factors, Image.Resampling.BILINEAR, fillcolor=(255, 255, 255)
    )
    return np.array(seen)
