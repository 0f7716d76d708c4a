"""The choice of a folder's reader: each layout is a module with LAYOUT, recognises(root) and load(…)."""

import logging
import math
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import numpy as np

from tg4mm.capture import colmap, dataset_tree, nerfstudio, real_captures, transforms
from tg4mm.capture.cameras import far_origin
from tg4mm.capture.model import Capture
from tg4mm.capture.transforms import SPLITS
from tg4mm.core.errors import CaptureError, MissingSplitError

_LOG = logging.getLogger("tg4mm")
_WARNED: set[Path] = set()  # datasets whose origin has been reported
# the first that recognises a folder reads it
READERS = (real_captures, dataset_tree, transforms, nerfstudio, colmap)


def load_capture(path: str | Path, split: str = "train", magnification: int | float | None = None) -> Capture:
    """The capture in a folder: cameras, timesteps and image paths. Pixels stay on disk (see `load_images`).

    Args:
        path: a dataset (docs/conventions.md), a nerfstudio or a COLMAP folder.
        split: "train", "test" or "val".
        magnification: reads ground truth at this α, a whole number (5: magnified/x005/); 0 is the capture as it was.
            Ground truth exists for the test cameras only, so `split` is ignored. `None`: no ground truth.

    Returns:
        C images with camera, timestep and path each.

    Raises:
        CaptureError: the folder or something in it is missing, malformed, or leads outside the folder. One line with
            file and value.
    """
    root = Path(path)
    if split not in SPLITS:
        raise CaptureError(f"split {split!r} is unknown; expected one of {', '.join(SPLITS)}")
    alpha = 0 if magnification is None else _whole_alpha(magnification)
    if magnification is not None:
        split = "test"
    if not root.is_dir():
        raise CaptureError(f"{root}: {'is not a folder' if root.exists() else 'does not exist'}")
    try:
        for reader in READERS:
            if reader.recognises(root):
                capture = reader.load(root, split, alpha)
                return capture.moved_to(_origin(reader, capture))
    except OSError as error:
        raise CaptureError(f"{error.filename or root}: cannot be read: {error.strerror}") from error
    known = "; ".join(reader.LAYOUT for reader in READERS)
    raise CaptureError(f"{root}: is not a dataset; tg4mm reads: {known}")


def _origin(reader: ModuleType, capture: Capture) -> np.ndarray:
    """`far_origin` of the training views, which all splits share; reported once where it is not 0."""
    if not _far(capture).any():
        return np.zeros(3)
    with suppress(MissingSplitError):
        capture = reader.load(capture.root, "train", 0) if capture.split != "train" else capture
    origin = _far(capture)
    if origin.any() and capture.root not in _WARNED:
        _WARNED.add(capture.root)
        place = ", ".join(f"{x:.10g}" for x in origin)
        _LOG.warning(
            f"{capture.root}: lies far from its origin: coordinates in results are relative to ({place})"
        )
    return origin


def _far(capture: Capture) -> np.ndarray:
    points = None if capture.points is None else capture.points.xyz
    return far_origin(capture.viewmats, capture.Ks, (capture.width, capture.height), points)


def _whole_alpha(alpha: int | float) -> int:
    if not math.isfinite(alpha) or alpha < 0 or alpha != int(alpha):
        raise CaptureError(
            f"magnification {alpha}: ground truth folders have whole α of at least 0, as magnified/x005"
        )
    return int(alpha)
