"""Which reader a folder gets: each layout is a module with LAYOUT, recognises(root) and load(…)."""

from __future__ import annotations

import math
from pathlib import Path

from tg4mm.capture import colmap, dataset_tree, nerf_synthetic, nerfstudio, real_captures
from tg4mm.capture.model import Capture
from tg4mm.capture.transforms import SPLITS
from tg4mm.core.errors import CaptureError

READERS = (
    real_captures,
    dataset_tree,
    nerf_synthetic,
    nerfstudio,
    colmap,
)  # the first that recognises a folder reads it


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
                return reader.load(root, split, alpha)
    except OSError as error:
        raise CaptureError(f"{error.filename or root}: cannot be read: {error.strerror}") from error
    known = "; ".join(reader.LAYOUT for reader in READERS)
    raise CaptureError(f"{root}: is not a dataset; tg4mm reads: {known}")


def _whole_alpha(alpha: int | float) -> int:
    if not math.isfinite(alpha) or alpha < 0 or alpha != int(alpha):
        raise CaptureError(
            f"magnification {alpha}: ground truth folders have whole α of at least 0, as magnified/x005"
        )
    return int(alpha)
