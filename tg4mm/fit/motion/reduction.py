"""How much of a recording the motion stage reads: where motion may be, and of a long one fewer, larger pixels.

The stage's time and its temporary files grow with pixels times pictures. Displacements of less than a pixel can be read
from pictures whose squares of pixels are averaged, as long as their texture is coarse enough; what is lost is told.
"""

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.capture.pictures import FilePictures
from tg4mm.capture.window import Window
from tg4mm.fit.motion.config import MotionConfig, asked_factor
from tg4mm.fit.motion.observations import fixed_cameras

PIXELS = 6e8  # times pictures, that are read as they are: about a minute of two cores a pass
PICTURE = 1920 * 1080  # pixels of one picture, likewise: more tell little to the Gaussians that there are
_SHORTEST = 270  # pixels along a side, which are never made fewer
_AROUND = 16  # pixels at least
_SAMPLED = 16  # pictures that tell how fine the texture is


def window_on(capture: Capture, config: MotionConfig, moves: np.ndarray | None = None) -> Window | None:
    """The window through which the pictures of fixed cameras are read; None where they are read as they are.

    moves [H, W] bool: where motion may be, if someone said so.
    """
    cameras = fixed_cameras(capture)
    if not cameras:
        return None
    whole = Window.on(capture.height, capture.width, 1, moves)
    factor = asked_factor(config.reduce)
    if factor is None:
        pixels = whole.rows * whole.columns
        share = max(pixels * sum(len(c.rows) for c in cameras) / PIXELS, pixels / PICTURE)
        factor = max(min(int(np.ceil(np.sqrt(share))), min(whole.size) // _SHORTEST), 1)
    # what lies around is held still: without it the prior would carry motion on beyond the region
    margin = max(_AROUND, max(whole.size) // 2)
    window = Window.on(capture.height, capture.width, factor, moves, margin)
    return None if factor == 1 and window.size == (capture.height, capture.width) else window


def note_on(capture: Capture, images: ImageStack | FilePictures, window: Window) -> str:
    """What a window that averages costs: by how much standard deviations grow.

    Motion is told by slopes of the picture. Averaging k² pixels makes independent noise k times smaller and slopes per
    pixel k times larger, where the texture is coarse. Slopes are told from noise by the product of two means over
    different pictures.
    """
    rows = fixed_cameras(capture)[0].rows
    some = rows[np.linspace(0, len(rows) - 1, min(len(rows), _SAMPLED)).round().astype(int)].tolist()
    whole = [
        np.mean([window.part(images.rgb(row)) for row in half], axis=0) for half in (some[::2], some[1::2])
    ]
    ratio = _slopes(*whole) / max(_slopes(*(_averaged(half, window) for half in whole)), 1e-30)
    height, width = window.size
    return (
        f"motion was fitted to pictures of {width}×{height}, {window.factor}×{window.factor} pixels averaged, which "
        f"makes ± about {np.sqrt(max(ratio, 1.0)):.2g} times as large; tg4mm measure reads them whole, and so does "
        "train with --region around what matters or --set motion.reduce=1"
    )


def _averaged(picture: np.ndarray, window: Window) -> np.ndarray:
    k = window.factor
    return picture.reshape(window.rows, k, window.columns, k, 3).mean((1, 3))


def _slopes(a: np.ndarray, b: np.ndarray) -> float:
    """Sum of products of the slopes of two pictures of one scene."""
    return float(sum(np.sum(np.diff(a, axis=axis) * np.diff(b, axis=axis)) for axis in (0, 1)))
