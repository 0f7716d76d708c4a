"""Unknown cameras: COLMAP's incremental mapper, and what came of it."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from tg4mm.capture.sfm.engine import colmap, extract, match
from tg4mm.capture.sfm.pairs import Pair, left_pairs, likely_pairs
from tg4mm.core.errors import CaptureError
from tg4mm.core.progress import progress
from tg4mm.core.records import read_formed, write_sealed

FEWEST_FEATURES = 20  # in a picture, for it to be placed at all
_DIGESTS = "digests.json"  # beside COLMAP's files
FEWEST_INLIERS = 15  # that COLMAP asks of the picture it places


def find_poses(
    database: Path,
    images: Path,
    masks: Path | None,
    names: Sequence[str],
    pairs: Sequence[Pair] | None,
    seed: int,
    threads: int,
) -> Any:
    """The pycolmap Reconstruction of most pictures; features and matches in the database are kept and added to.

    pairs: of pictures to match; None: of those that are alike, and all of pictures that those tie to no others.
    Raises CaptureError where there is too little texture or overlap.
    """
    counts = extract(database, images, names, masks, threads)
    poor = [name for name, count in zip(names, counts, strict=True) if count < FEWEST_FEATURES]
    if len(names) - len(poor) < 3:
        raise CaptureError(
            f"too little texture: {len(poor)} of {len(names)} pictures have fewer than {FEWEST_FEATURES} features, "
            f"{shown_names(poor)}"
        )
    chosen = likely_pairs(database, names) if pairs is None else pairs
    found = match(database, chosen, seed, threads)
    left = left_pairs(database, names, chosen) if pairs is None else []
    if left:
        found = match(database, left, seed, threads)
    if found == 0:
        raise CaptureError(f"no two of the {len(names)} pictures overlap: not one pair could be matched")
    return _best_model(database, images, names, seed, threads)


def _best_model(database: Path, images: Path, names: Sequence[str], seed: int, threads: int) -> Any:
    c = colmap("structure from motion")
    c.set_random_seed(seed)
    folder = database.parent / ".models.tmp"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    placed, total = 0, len(names)
    options = mapper_options(c, seed, threads)
    options.image_names = list(names)  # others in the database are placed later
    with progress("poses", total, "pictures") as update:

        def next_image() -> None:
            nonlocal placed
            placed = min(placed + 1, total)
            update(placed)

        models = c.incremental_mapping(database, images, folder, options, next_image_callback=next_image)
    shutil.rmtree(folder, ignore_errors=True)
    if not models:
        raise CaptureError(
            f"no pair to start from: no two of the {total} pictures show enough of the same scene from different places"
        )
    return max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()))


def mapper_options(c: Any, seed: int, threads: int) -> Any:
    """COLMAP's defaults, but for small sets and small pictures: fewer inliers suffice."""
    options = c.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = threads
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    options.min_model_size = 3
    options.mapper.init_min_num_inliers = 50
    options.mapper.abs_pose_min_num_inliers = FEWEST_INLIERS
    return options


def save_model(model: Any, folder: Path) -> None:
    """Write the model as `folder`, whole or not at all, with digests of its files."""
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    model.write(temporary)
    write_sealed(temporary / _DIGESTS, _digests(temporary))
    os.replace(temporary, folder)


def saved_model(folder: Path) -> Any:
    """The pycolmap Reconstruction that `save_model` wrote.

    Raises CaptureError for files that are not as they were written: COLMAP's reader trusts what it finds.
    """
    try:
        is_whole = read_formed(folder / _DIGESTS, {str: str}) == _digests(folder)
    except (OSError, ValueError):
        is_whole = False
    if not is_whole:
        raise CaptureError(f"{folder}: is not as COLMAP wrote it; remove it and give the command again")
    return colmap("tg4mm sfm").Reconstruction(folder)


def _digests(folder: Path) -> dict[str, str]:
    """SHA-256 of a model's files, by name."""
    files = sorted(path for path in folder.iterdir() if path.name != _DIGESTS)
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def registered(model: Any) -> dict[str, Any]:
    """Every placed pycolmap Image by its name."""
    return {image.name: image for image in model.images.values() if image.has_pose}


def shown_names(names: Sequence[str], most: int = 6) -> str:
    """The first of the pictures' names, as the user knows them."""
    shown = ", ".join(unquote(name) for name in names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def check_registered(names: Sequence[str], placed: dict[str, Any], fewest: int) -> list[str]:
    """The names that were not placed. Raises CaptureError listing them where half are, or fewer than `fewest` were."""
    missing = [name for name in names if name not in placed]
    if missing and (2 * len(missing) >= len(names) or len(names) - len(missing) < fewest):
        raise CaptureError(
            f"{len(missing)} of {len(names)} pictures could not be placed: {shown_names(missing)}; "
            "a sweep/ of further pictures between them helps"
        )
    return missing
