"""Reader of a single NeRF-synthetic folder: a capture of one timestep."""

from __future__ import annotations

from pathlib import Path

from tg4mm.capture.model import Capture
from tg4mm.capture.scene import read_scene
from tg4mm.capture.transforms import SPLITS, assemble, read_views
from tg4mm.core.errors import CaptureError

LAYOUT = "a NeRF-synthetic folder (transforms_train.json)"


def recognises(root: Path) -> bool:
    """Whether a transforms_<split>.json lies in the folder."""
    return any((root / f"transforms_{split}.json").is_file() for split in SPLITS)


def load(root: Path, split: str, alpha: int) -> Capture:
    """The folder's split as a capture with T = 1; fps and scale are known only if a scene.json says them."""
    if alpha:
        raise CaptureError(f"{root}: is one timestep, which has no images magnified by {alpha}")
    return assemble(root, split, read_views(root, root, split, 0), read_scene(root, needs_fps=False), 1)
