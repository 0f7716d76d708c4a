"""Calls of pycolmap, in steps that can be stopped, resumed and repeated; which pairs of pictures are matched."""

import importlib.util
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations, groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any, TextIO

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.extras import install
from tg4mm.core.progress import progress

PAIRS_AT_ONCE = 64  # matched between two reports of progress; what a kill loses
# COLMAP's default, spelt out: a picture of 12 megapixels with more takes minutes per pair to match.
MAX_FEATURES = 8192
# Longer side from which pictures are searched as they are: they have MAX_FEATURES without the smallest ones, of which
# COLMAP drops those too many. Others are doubled first, for more and finer features.
LARGE_PX = 3000

Pair = tuple[str, str]

EXHAUSTIVE_MOST = 40  # frames of a sequence; above, each is matched with its neighbours only
EVERY = 4  # frames of a sequence that other pictures are matched with
OVERLAP = 12  # neighbours in a sequence, and then those at 2, 4, 8 … times that

CHOSEN_FROM = 30  # pictures in no order, above which each is matched with those most like it only
MOST_LIKE = 10  # pictures that each is matched with, and then the 2 × 10th, 4 × 10th … most like it
LARGEST = 512  # features of a picture that are compared for that
RATIO = 0.8  # of the angle to the nearest descriptor to that to the second nearest, COLMAP's own
FIRM = 30  # verified matches of a pair that is relied on
FEWEST_FIRM = 4  # such pairs that a picture needs, or it is matched with all others after all


def available() -> bool:
    """Return whether pycolmap is installed."""
    return importlib.util.find_spec("pycolmap") is not None


def colmap(what: str) -> ModuleType:
    """The module pycolmap, its own log silent. Raises Tg4mmError, naming `what` needs it, where it is absent."""
    try:
        import pycolmap
    except ImportError as error:
        raise Tg4mmError(f"{what} needs pycolmap ({error}): {install('sfm')}") from None
    pycolmap.logging.minloglevel = 3  # errors are reported in one line by tg4mm
    if threading.current_thread() is threading.main_thread():  # its own handler prints a trace of C++
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
    return pycolmap


@contextmanager
def silenced() -> Iterator[TextIO]:
    """Silence a call that resets pycolmap's log level: its lines on the process's stderr are dropped.

    Yields the stream for the program's own messages meanwhile.
    """
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        with os.fdopen(kept, "w", buffering=1, closefd=False) as stream:
            yield stream if sys.stderr is sys.__stderr__ else sys.stderr
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)
        colmap("tg4mm sfm")


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


def chosen_pairs(names: Sequence[str], frames: int, ordered: bool, matching: str) -> list[Pair] | None:
    """The pairs to match, None for those that are alike. The first `frames` are a recording's; ordered: in time."""
    if matching == "sequential" or (matching == "auto" and ordered and frames > EXHAUSTIVE_MOST):
        return picture_pairs(names, frames)
    return None if matching == "auto" and len(names) > CHOSEN_FROM else picture_pairs(names)


def picture_pairs(names: Sequence[str], sequence: int = 0) -> list[Pair]:
    """Return the pairs of pictures to match.

    The first `sequence` pictures are frames in order: each is paired with the next OVERLAP ones and then with ever
    sparser ones. The other pictures are paired with each other, and with every EVERY-th frame.
    """
    frames, others = list(names[:sequence]), list(names[sequence:])
    steps = [*range(1, OVERLAP + 1), *_doubled(2 * OVERLAP, len(frames))]
    pairs = [(frames[i], frames[i + s]) for i in range(len(frames)) for s in steps if i + s < len(frames)]
    pairs += [(frame, other) for frame in frames[::EVERY] for other in others]
    return pairs + list(combinations(others, 2))


def _doubled(first: int, end: int) -> list[int]:
    """first, 2 first, 4 first … below `end`."""
    steps = []
    while first < end:
        steps.append(first)
        first *= 2
    return steps


def likely_pairs(database: Path, names: Sequence[str]) -> list[Pair]:
    """Pairs of the pictures `names`, whose features are in the database: each with those most like it.

    Alike are pictures of whose LARGEST features, by scale, many are mutually nearest. Farther ranks are taken too, ever
    rarer ones, which tie together groups of pictures from one place.
    """
    with opened(database) as db:
        descriptors = [_largest(db, name) for name in names]
    n = len(names)
    alike = np.zeros((n, n), np.int64)
    with progress("comparing", n, "pictures") as update:
        for i in range(n):
            for j in range(i + 1, n):
                alike[i, j] = alike[j, i] = matched(descriptors[i], descriptors[j])
            update(i + 1)
    return [(names[i], names[j]) for i, j in most_alike(alike)]


def most_alike(alike: np.ndarray, most: int = MOST_LIKE) -> list[tuple[int, int]]:
    """Pairs i < j in order, of [n, n] likenesses: each with the `most` greatest, and those of rank 2, 4, 8 … × most."""
    n = len(alike)
    others = np.where(np.eye(n, dtype=bool), -1, alike)  # itself last
    order = np.argsort(-others, axis=1, kind="stable")
    ranks = [*range(min(most, n - 1)), *(rank - 1 for rank in _doubled(2 * most, n))]
    pairs = {(min(i, j), max(i, j)) for i in range(n) for j in order[i, ranks].tolist()}
    return sorted(pairs)


def _largest(db: Any, name: str) -> np.ndarray:
    """Return [≤ LARGEST, D] float32 descriptors of unit length, those of the largest features."""
    image = db.read_image_with_name(name).image_id
    keypoints = np.asarray(db.read_keypoints(image), np.float64)
    descriptors = np.asarray(db.read_descriptors(image).data, np.float32)
    area = np.abs(keypoints[:, 2] * keypoints[:, 5] - keypoints[:, 3] * keypoints[:, 4])
    chosen = descriptors[np.argsort(-area, kind="stable")[:LARGEST]]
    return chosen / np.maximum(np.linalg.norm(chosen, axis=1, keepdims=True), 1e-9)


def matched(first: np.ndarray, second: np.ndarray) -> int:
    """Return the number of unambiguous mutual nearest neighbours of unit descriptors [F, D] and [G, D]."""
    if len(first) < 2 or len(second) < 2:
        return 0
    cosine = first @ second.T
    rows, nearest = np.arange(len(first)), cosine.argmax(axis=1)
    mutual = cosine.argmax(axis=0)[nearest] == rows
    best = cosine[rows, nearest]
    cosine[rows, nearest] = -1
    rival = cosine.max(axis=1)
    clear = np.arccos(np.clip(best, -1, 1)) < RATIO * np.arccos(np.clip(rival, -1, 1))
    return int((mutual & clear).sum())


def left_pairs(database: Path, names: Sequence[str], done: Sequence[Pair]) -> list[Pair]:
    """All other pairs of pictures that the matched pairs `done` tie to the others too loosely.

    Such are those with fewer than FEWEST_FIRM pairs of FIRM verified matches, and those that such pairs do not lead to
    from most pictures.
    """
    c = colmap("structure from motion")
    with opened(database) as db:
        ids = {name: db.read_image_with_name(name).image_id for name in names}
        numbers, inliers = db.read_two_view_geometry_num_inliers()
    verified = dict(zip((c.pair_id_to_image_pair(k) for k in numbers), inliers, strict=True))
    row = {name: i for i, name in enumerate(names)}
    firm = np.zeros((len(names), len(names)), bool)
    for a, b in done:
        low, high = sorted((ids[a], ids[b]))
        firm[row[a], row[b]] = firm[row[b], row[a]] = verified.get((low, high), 0) >= FIRM
    loose = loosely_tied(firm)
    known = {frozenset(pair) for pair in done}
    return [
        (a, b)
        for (i, a), (j, b) in combinations(enumerate(names), 2)
        if (loose[i] or loose[j]) and frozenset((a, b)) not in known
    ]


def loosely_tied(firm: np.ndarray) -> np.ndarray:
    """Return the pictures with fewer than FEWEST_FIRM of the firm pairs [n, n], or outside the largest component."""
    _, parts = connected_components(csr_matrix(firm), directed=False)
    largest = np.bincount(parts).argmax()
    return (firm.sum(axis=1) < FEWEST_FIRM) | (parts != largest)
