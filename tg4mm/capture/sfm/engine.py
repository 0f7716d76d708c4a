"""Calls of pycolmap, in steps that can be stopped, resumed and repeated."""

import importlib.util
import os
import signal
import threading
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.extras import install
from tg4mm.core.progress import progress

PAIRS_AT_ONCE = 64  # matched between two reports of progress; what a kill loses
# COLMAP's default, spelt out: a picture of 12 megapixels with more takes minutes per pair to match.
MAX_FEATURES = 8192
# Longer side from which pictures are searched as they are: they have MAX_FEATURES without the smallest ones, of which
# COLMAP drops those too many. Others are doubled first, for more and finer features.
LARGE_PX = 3000


def available() -> bool:
    """Return whether pycolmap is installed."""
    return importlib.util.find_spec("pycolmap") is not None


def colmap(what: str) -> ModuleType:
    """The module pycolmap, its own log silent. Raises Tg4mmError, naming `what` needs it, where it is absent."""
    try:
        import pycolmap
    except ImportError as error:
        raise Tg4mmError(f"{what} needs pycolmap ({error}): {install('sfm')}") from None
    pycolmap.logging.minloglevel = 3  # what goes wrong is said in one line of our own
    if threading.current_thread() is threading.main_thread():  # its own handler prints a trace of C++
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
    return pycolmap


def extract(
    database: Path, images: Path, names: Sequence[str], masks: Path | None, threads: int = 1
) -> list[int]:
    """SIFT features of every picture, into the database, where pictures are known already; those done are skipped.

    masks: a folder of <name>.png, black where no feature may lie. Returns the number of features of each.
    """
    c = colmap("structure from motion")
    reader = c.ImageReaderOptions()
    if masks is not None:
        reader.mask_path = masks
    options = c.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = threads, False
    options.sift.max_num_features = MAX_FEATURES
    with opened(database) as db:
        large = {name: _is_large(db, name) for name in names}
    counts = []
    at_once = threads if threads > 0 else os.cpu_count() or 1
    with progress("features", len(names), "pictures") as update:
        for is_large, alike in groupby(names, key=large.__getitem__):
            options.sift.first_octave = 0 if is_large else -1
            for some in _parts(list(alike), at_once):
                c.extract_features(
                    database,
                    images,
                    some,
                    reader_options=reader,
                    extraction_options=options,
                    device=c.Device.cpu,
                )
                counts += _feature_counts(database, some)
                update(len(counts), features=sum(counts))
    return counts


def _is_large(db: Any, name: str) -> bool:
    image = db.read_image_with_name(name)
    camera = db.read_camera(image.camera_id)
    return max(camera.width, camera.height) >= LARGE_PX


def _parts(values: Sequence[Any], size: int) -> list[Sequence[Any]]:
    return [values[i : i + size] for i in range(0, len(values), size)]


def _feature_counts(database: Path, names: Sequence[str]) -> list[int]:
    with opened(database) as db:
        return [db.num_keypoints_for_image(db.read_image_with_name(name).image_id) for name in names]


def match(database: Path, pairs: Sequence[tuple[str, str]], seed: int, threads: int = 1) -> int:
    """Match and verify (RANSAC) the pairs of pictures; those done are skipped. Returns how many pairs have matches."""
    c = colmap("structure from motion")
    options = c.FeatureMatchingOptions()
    options.num_threads, options.use_gpu = threads, False
    verification = c.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    with TemporaryDirectory() as folder, progress("matching", len(pairs), "pairs") as update:
        for first in range(0, len(pairs), PAIRS_AT_ONCE):
            chunk = pairs[first : first + PAIRS_AT_ONCE]
            path = Path(folder) / "pairs.txt"
            path.write_text("".join(f"{a} {b}\n" for a, b in chunk), encoding="utf-8")
            pairing = c.ImportedPairingOptions()
            pairing.match_list_path = path
            c.match_image_pairs(
                database,
                matching_options=options,
                pairing_options=pairing,
                verification_options=verification,
                device=c.Device.cpu,
            )
            update(first + len(chunk))
    with opened(database) as db:
        _, inliers = db.read_two_view_geometry_num_inliers()  # pairs that failed are there too, with 0
        return sum(1 for n in inliers if n > 0)


class opened:
    """`with opened(path) as db`: COLMAP's database, created if absent, closed at the end."""

    def __init__(self, path: Path) -> None:
        self._db: Any = colmap("structure from motion").Database.open(path)

    def __enter__(self) -> Any:
        return self._db

    def __exit__(self, *_error: object) -> None:
        self._db.close()
