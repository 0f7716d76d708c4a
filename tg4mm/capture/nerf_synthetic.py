"""Reader of a single NeRF-synthetic folder, and of D-NeRF's, whose frames have times."""

from pathlib import Path

from tg4mm.capture.model import Capture
from tg4mm.capture.scene import read_scene
from tg4mm.capture.transforms import SPLITS, assemble, read_views, timed, whole_dataset
from tg4mm.core.errors import CaptureError

LAYOUT = "a NeRF-synthetic folder (transforms_train.json)"


def recognises(root: Path) -> bool:
    """Return whether the folder has a transforms_<split>.json."""
    return any((root / f"transforms_{split}.json").is_file() for split in SPLITS)


def load(root: Path, split: str, alpha: int) -> Capture:
    """The folder's split as a capture; fps and scale are known only if a scene.json says them.

    Of one timestep, or of as many as its frames have times (D-NeRF), unless it is itself a timestep of a dataset.
    """
    if alpha:
        raise CaptureError(f"{root}: is one timestep, which has no images magnified by {alpha}")
    views, scene = read_views(root, root, split, 0, may_miss=True), read_scene(root, needs_fps=False)
    n_timesteps = 1
    if whole_dataset(root) is None:
        views, scene, n_timesteps = timed(views, scene)
    return assemble(root, split, views, scene, n_timesteps)
