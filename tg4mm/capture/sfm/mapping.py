"""Unknown cameras: COLMAP's incremental mapper, and the model that it makes.

The frames of a moving camera are placed one by one against a model of the sharp ones, then all are adjusted together.
"""

import copy
import hashlib
import os
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from tg4mm.capture.sfm.engine import Pair, colmap, extract, left_pairs, likely_pairs, match, opened, silenced
from tg4mm.core.errors import CaptureError
from tg4mm.core.progress import progress
from tg4mm.core.untrusted import read_formed, write_sealed

FEWEST_FEATURES = 20  # in a picture, for it to be placed at all
_DIGESTS = "digests.json"  # beside COLMAP's files
FEWEST_INLIERS = 15  # that COLMAP asks of the picture it places

NEIGHBOURS = 3  # frames of the model on either side that a frame is matched with
FEWEST_OF_FRAME = 30  # points of the model that a frame must show
INLIER_PX = 3.0
GROWTH = 0.05  # of the sum of squared reprojection errors, up to which all lenses are taken for pinholes
SLIGHT_PX = 0.5  # largest bend of a lens that is taken for one whatever the others are
TRIED, CLEAR = 12, 0.7  # pairs to start from: so many with most parallax, at least this share of the largest
FEW_DEGREES = 16.0  # of the first pair: COLMAP's own search, which is fast there, is left to it
FEWEST_OF_PAIR = 100  # verified matches
PRECISE_PX = 1.0  # of the first pair's points: COLMAP's 4 pixels hide the parallax of a small angle
STEPS = 50  # of an adjustment, as COLMAP's mapper takes
TOLERANCE = 1e-6  # relative change of the squared error at which it ends


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
    return best_model(database, images, names, seed, threads)


def best_model(database: Path, images: Path, names: Sequence[str], seed: int, threads: int) -> Any:
    """Return the pycolmap Reconstruction of most pictures, whose matches are in the database. Raises CaptureError."""
    c = colmap("structure from motion")
    c.set_random_seed(seed)
    folder = database.parent / ".models.tmp"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    placed, total = 0, len(names)
    options = mapper_options(c, seed, threads)
    options.image_names = list(names)  # others in the database are placed later
    if (start := widest_pair(database, names, seed)) is not None and start.degrees < FEW_DEGREES:
        start.apply(options)
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


# COLMAP tries pairs from the one with most matches, whose views hardly differ, and all of them five times, down to an
# angle of 4 degrees: minutes of search that find nothing where a hand kept the camera almost in one place.
@dataclass(frozen=True)
class FirstPair:
    """Two pictures to start from, by their numbers in the database, and the median angle between their points' rays."""

    ids: tuple[int, int]
    degrees: float

    def apply(self, options: Any) -> None:
        """Let COLMAP start here, and keep points that are seen under angles in proportion."""
        options.init_image_id1, options.init_image_id2 = self.ids
        options.init_num_trials = 1
        options.mapper.init_min_tri_angle = self.degrees / 2
        options.mapper.init_max_error = PRECISE_PX
        least = min(options.mapper.filter_min_tri_angle, self.degrees / 8)
        options.mapper.filter_min_tri_angle = options.triangulation.min_angle = least


def widest_pair(database: Path, names: Sequence[str], seed: int) -> FirstPair | None:
    """Return, of the matched pairs with most parallax, the one whose views differ most; None without one."""
    c = colmap("structure from motion")
    options = c.TwoViewGeometryOptions()
    options.ransac.random_seed, options.ransac.max_error = seed, PRECISE_PX
    with opened(database) as db:
        pairs = _MatchedPairs.of(c, db, names)
        parallax = {ids: pairs.parallax_px(ids) for ids in pairs.matches}
        most = max(parallax.values(), default=0.0)  # with much less of it the angle is noise
        clear = [ids for ids in sorted(parallax, key=parallax.__getitem__) if parallax[ids] > CLEAR * most]
        found = [FirstPair(ids, pairs.degrees(c, ids, options)) for ids in clear[-TRIED:]]
    return max(found, key=lambda pair: pair.degrees, default=None)


@dataclass(frozen=True)
class _MatchedPairs:
    """Verified matches of pictures in a database, by the pictures' numbers."""

    cameras: dict[int, Any]
    points: dict[int, np.ndarray]  # [F, 2] pixels
    matches: dict[tuple[int, int], np.ndarray]  # [m, 2] uint32

    @classmethod
    def of(cls, c: Any, db: Any, names: Sequence[str]) -> "_MatchedPairs":
        images = {image.image_id: image for image in (db.read_image_with_name(name) for name in names)}
        numbers, geometries = db.read_two_view_geometries()
        pairs = zip((c.pair_id_to_image_pair(number) for number in numbers), geometries, strict=True)
        matches = {
            ids: np.asarray(geometry.inlier_matches)
            for ids, geometry in pairs
            if set(ids) <= set(images) and len(geometry.inlier_matches) >= FEWEST_OF_PAIR
        }
        cameras = {i: db.read_camera(image.camera_id) for i, image in images.items()}
        points = {i: np.asarray(db.read_keypoints(i), np.float64)[:, :2] for i in images}
        return cls(cameras, points, matches)

    def parallax_px(self, ids: tuple[int, int]) -> float:
        """Return the median distance of matches from one affine map of the pictures, which shows no depth."""
        first, second = (self.points[i][self.matches[ids][:, k]] for k, i in enumerate(ids))
        design = np.concatenate([first, np.ones((len(first), 1))], 1)
        left = second - design @ np.linalg.lstsq(design, second, rcond=None)[0]
        return float(np.median(np.linalg.norm(left, axis=1)))

    def degrees(self, c: Any, ids: tuple[int, int], options: Any) -> float:
        """Return the median angle between the rays of a pair's points; 0 where no pose explains the matches."""
        (a, b), matches = ids, self.matches[ids]
        seen = self.cameras[a], self.points[a], self.cameras[b], self.points[b]
        geometry = c.estimate_calibrated_two_view_geometry(*seen, matches, options)
        has_pose = c.estimate_two_view_geometry_pose(*seen, geometry)
        return float(np.degrees(geometry.tri_angle)) if has_pose else 0.0


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
        raise CaptureError(
            f"{folder}: has changed since COLMAP wrote it, or is damaged; remove it and run the command again"
        )
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


# Bend, focal length and shape of the scene trade places with hardly any change of the reprojection error, and a bend
# takes up errors that all pictures share. Phones straighten their videos themselves, so the pinhole is the better guess
# where the features, which lie where there is texture, do not object to it.
def as_pinholes(model: Any, threads: int) -> Any:
    """The pycolmap Reconstruction with pinholes for all lenses, if those explain the pictures as well.

    Else for lenses that bend less than SLIGHT_PX, the others kept. Focal lengths, poses and points are adjusted;
    `model` is left as it is.
    """
    bent = [i for i, camera in model.cameras.items() if not camera.is_undistorted()]
    if not bent:
        return model
    straight = _with_pinholes(model, bent, threads)
    if squared_error(straight) <= (1 + GROWTH) * squared_error(model):
        return straight
    slight = [i for i in bent if bend_px(model.cameras[i]) <= SLIGHT_PX]
    return _with_pinholes(model, slight, threads) if slight else model


def bend_px(camera: Any) -> float:
    """Return the largest distance, pixels at corners and edges, between a camera and its pinhole."""
    w, h = camera.width, camera.height
    pixels = np.array([(x * w, y * h) for x in (0, 0.5, 1) for y in (0, 0.5, 1) if (x, y) != (0.5, 0.5)])
    rays = np.asarray(camera.cam_from_img(pixels))
    K = np.asarray(camera.calibration_matrix())
    straight = rays[:, :2] * [K[0, 0], K[1, 1]] + K[:2, 2]
    return float(np.linalg.norm(straight - pixels, axis=1).max())


def squared_error(model: Any) -> float:
    """Return the sum of squared reprojection errors over all observations, from each point's mean error."""
    model.update_point_3d_errors()
    return float(sum(point.error**2 * point.track.length() for point in model.points3D.values()))


def adjust(model: Any, threads: int) -> None:
    """Run bundle adjustment of all placed pictures and points, in place; of the lenses only the focal length.

    COLMAP does not report progress, so only the elapsed time is shown.
    """
    c = colmap("tg4mm sfm")
    options = c.BundleAdjustmentOptions()
    options.refine_extra_params = options.print_summary = False
    solver = options.ceres.solver_options
    solver.num_threads, solver.max_num_iterations, solver.function_tolerance = threads, STEPS, TOLERANCE
    with silenced() as stream, progress("adjusting", 1, "run", brief=True, stream=stream) as update:
        # an adjuster's own `solve` would stop all other threads of Python
        c.bundle_adjustment(model, options)
        model.update_point_3d_errors()
        update(1, error_px=float(model.compute_mean_reprojection_error()))


def _with_pinholes(model: Any, cameras: list[int], threads: int) -> Any:
    model = copy.deepcopy(model)
    for i in cameras:
        params = np.array(model.cameras[i].params)
        params[list(model.cameras[i].extra_params_idxs())] = 0
        model.cameras[i].params = params
    adjust(model, threads)
    return model


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
    if len(seen) < FEWEST_OF_FRAME:
        return False
    features, points = np.array(list(seen)), list(seen.values())
    xyz = np.array([model.points3D[point].xyz for point in points])
    estimation = c.AbsolutePoseEstimationOptions()
    estimation.ransac.max_error, estimation.ransac.random_seed = INLIER_PX, seed
    camera = model.cameras[known.camera_id]
    found = c.estimate_and_refine_absolute_pose(keypoints[features], xyz, camera, estimation)
    if found is None or found["num_inliers"] < FEWEST_OF_FRAME:
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
