"""Frames of a moving camera placed one by one against a model of its sharp ones, then all adjusted together."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.sfm.engine import colmap, extract, match, opened
from tg4mm.capture.sfm.mapping import adjust
from tg4mm.core.progress import progress

NEIGHBOURS = 3  # frames of the model on either side that a frame is matched with
FEWEST_INLIERS = 30  # points of the model that a frame must show
INLIER_PX = 3.0


@dataclass(frozen=True)
class Workspace:
    """COLMAP's files, and how it is to work."""

    database: Path
    images: Path
    masks: Path | None
    seed: int
    threads: int


def register_frames(model: Any, work: Workspace, names: Sequence[str], keys: Sequence[str]) -> list[str]:
    """Place the frames `names` (in order of time) that are not among `keys` into the pycolmap Reconstruction.

    keys: names of frames that the model was made of. Changes the model in place: it gets images, observations, and a
    last adjustment of all. Returns the names that could not be placed.
    """
    rest = [name for name in names if name not in set(keys)]
    neighbours = nearest_keys(names, keys)
    extract(work.database, work.images, rest, work.masks, work.threads)
    pairs = [(name, key) for name in rest for key in neighbours[name]]
    match(work.database, pairs, work.seed, work.threads)
    missing = []
    with opened(work.database) as db, progress("registering", len(rest), "frames") as update:
        for done, name in enumerate(rest, 1):
            if not _place(model, db, name, neighbours[name], work.seed):
                missing.append(name)
            update(done, placed=done - len(missing))
    adjust(model, work.threads)
    return missing


def nearest_keys(names: Sequence[str], keys: Sequence[str]) -> dict[str, list[str]]:
    """Return, for each frame, the NEIGHBOURS key frames before and after it in time."""
    where = [i for i, name in enumerate(names) if name in set(keys)]
    at = np.searchsorted(where, np.arange(len(names)))
    return {
        name: [names[where[k]] for k in range(max(0, i - NEIGHBOURS), min(len(where), i + NEIGHBOURS))]
        for name, i in zip(names, at, strict=True)
    }


def _place(model: Any, db: Any, name: str, keys: Sequence[str], seed: int) -> bool:
    """Give the frame a pose, if enough points of the model are seen in it."""
    c = colmap("tg4mm sfm")
    known = db.read_image_with_name(name)
    keypoints = np.asarray(db.read_keypoints(known.image_id), np.float64)[:, :2]
    seen = _seen_points(model, db, known.image_id, keys)
    if len(seen) < FEWEST_INLIERS:
        return False
    features, points = np.array(list(seen)), list(seen.values())
    xyz = np.array([model.points3D[point].xyz for point in points])
    estimation = c.AbsolutePoseEstimationOptions()
    estimation.ransac.max_error, estimation.ransac.random_seed = INLIER_PX, seed
    camera = model.cameras[known.camera_id]
    found = c.estimate_and_refine_absolute_pose(keypoints[features], xyz, camera, estimation)
    if found is None or found["num_inliers"] < FEWEST_INLIERS:
        return False
    image = c.Image(name=name, keypoints=keypoints, camera_id=known.camera_id, image_id=known.image_id)
    model.add_image_with_trivial_frame(image, found["cam_from_world"])
    for feature, point, inlier in zip(features, points, found["inlier_mask"], strict=True):
        if inlier:
            model.add_observation(point, c.TrackElement(known.image_id, int(feature)))
    return True


def _seen_points(model: Any, db: Any, image_id: int, keys: Sequence[str]) -> dict[int, int]:
    """Return, for a picture's features, the model point supported by most matches with the frames `keys`."""
    votes: dict[int, Counter[int]] = {}
    for key in keys:
        image = model.find_image_with_name(key)
        if image is None or not image.has_pose:
            continue
        for feature, other in db.read_two_view_geometry(image_id, image.image_id).inlier_matches:
            point = image.points2D[int(other)]
            if point.has_point3D():
                votes.setdefault(int(feature), Counter())[int(point.point3D_id)] += 1
    # one feature a point: a second one nearby would see the same twice
    taken: dict[int, tuple[int, int]] = {}
    for feature, counter in votes.items():
        point, count = counter.most_common(1)[0]
        if point not in taken or taken[point][1] < count:
            taken[point] = (feature, count)
    return {feature: point for point, (feature, _) in taken.items()}
