"""Points for known cameras, the initialisation of [TG4MM] Table IV: SIFT, guided matches, COLMAP's triangulator.

`SfmPoints` are the points of any reconstruction.
"""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import numpy as np
from PIL import Image
from scipy.ndimage import binary_dilation

from tg4mm.capture.cameras import working_box
from tg4mm.capture.model import SurfacePoints
from tg4mm.capture.sfm.engine import colmap, extract, opened
from tg4mm.core.progress import progress

ROWS = 1024  # features compared at once: bounds memory to ROWS × features


@dataclass(frozen=True)
class SfmPoints(SurfacePoints):
    """Triangulated points, in the order in which they were found."""

    errors_px: np.ndarray  # [M] float32, mean reprojection error of each, pixels
    n_views: np.ndarray  # [M] int64, pictures in which each was found

    def __len__(self) -> int:
        """M, the number of points."""
        return len(self.xyz)

    def kept(self, keep: np.ndarray) -> "SfmPoints":
        """Return the points where `keep` [M] is true."""
        return SfmPoints(self.xyz[keep], self.rgb[keep], self.errors_px[keep], self.n_views[keep])


def points_of(reconstruction) -> SfmPoints:
    """All points of a pycolmap Reconstruction, by number."""
    points = [reconstruction.points3D[i] for i in sorted(reconstruction.points3D)]
    return SfmPoints(
        np.array([p.xyz for p in points], np.float32).reshape(-1, 3),
        np.array([p.color for p in points], np.uint8).reshape(-1, 3),
        np.array([p.error for p in points], np.float32),
        np.array([p.track.length() for p in points], np.int64),
    )


def outside_masks(
    xyz: np.ndarray, viewmats: np.ndarray, Ks: np.ndarray, masks: np.ndarray, slack: int = 2
) -> np.ndarray:
    """Return [M] bool: true for points that some picture shows as background.

    masks [V, H, W] bool, true on the object, here grown by `slack` pixels, since a feature lies on a pixel and a
    point does not. A point outside all pictures, or behind all cameras, counts as outside too.
    """
    height, width = masks.shape[1:]
    outside, seen = np.zeros(len(xyz), bool), np.zeros(len(xyz), bool)
    for viewmat, K, mask in zip(viewmats, Ks, masks, strict=True):
        cam = xyz @ viewmat[:3, :3].T + viewmat[:3, 3]
        z = np.maximum(cam[:, 2], 1e-6)
        # clipped before the cast: a point close to the camera's plane lands beyond any integer
        column = np.clip(np.floor(K[0, 0] * cam[:, 0] / z + K[0, 2]), -1, width).astype(int)
        row = np.clip(np.floor(K[1, 1] * cam[:, 1] / z + K[1, 2]), -1, height).astype(int)
        inside = (cam[:, 2] > 1e-6) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        grown = binary_dilation(mask, iterations=slack) if slack else mask
        outside[inside] |= ~grown[row[inside], column[inside]]
        seen |= inside
    return outside | ~seen


# COLMAP's own matcher compares every feature with every other and finds the geometry afterwards; on small pictures and
# repeated texture its ratio test then drops most. With the cameras known, the few features near the epipolar line are
# the only rivals, no random sampling is needed, and the result depends on nothing but the pictures.
@dataclass(frozen=True)
class Features:
    """Features of one picture."""

    rays: np.ndarray  # [F, 3] float64, K⁻¹ (u, v, 1), camera axes
    descriptors: np.ndarray  # [F, D] float32 of unit length


def features_of(keypoints: np.ndarray, descriptors: np.ndarray, K: np.ndarray) -> Features:
    """Features at keypoints [F, ≥ 2] in pixels, with descriptors [F, D] of any length."""
    homogeneous = np.concatenate([keypoints[:, :2], np.ones((len(keypoints), 1))], axis=1)
    descriptors = descriptors.astype(np.float32)
    norm = np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-9)
    return Features(homogeneous @ np.linalg.inv(K).T, descriptors / norm)


def essential(viewmat1: np.ndarray, viewmat2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """E [3, 3] with x₂ᵀ E x₁ = 0, and [R | t] [3, 4] of camera 2 from camera 1; viewmats are world-to-camera."""
    relative = (viewmat2 @ np.linalg.inv(viewmat1))[:3]
    x, y, z = relative[:, 3]
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ relative[:, :3], relative


def guided_matches(
    first: Features, second: Features, E: np.ndarray, tolerance: float, ratio: float, distance: float
) -> np.ndarray:
    """Matches [m, 2] (uint32, index in first and second): mutual nearest descriptors on the epipolar line.

    tolerance: Sampson distance on the plane z = 1, that is pixels / focal length. ratio: largest angle between
    descriptors, as a share of that to the second nearest on the line. distance: largest such angle, radians.
    """
    if len(first.rays) == 0 or len(second.rays) == 0:
        return np.zeros((0, 2), np.uint32)
    forward, angle = _nearest(first, second, E, tolerance, ratio, distance)
    backward, _ = _nearest(second, first, E.T, tolerance, ratio, distance)
    rows = np.flatnonzero(np.isfinite(angle))
    rows = rows[backward[forward[rows]] == rows]
    return np.stack([rows, forward[rows]], axis=1).astype(np.uint32)


def _nearest(
    first: Features, second: Features, E: np.ndarray, tolerance: float, ratio: float, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each feature of `first`, its match in `second` (−1: none) and their angle (inf: none)."""
    nearest = np.full(len(first.rays), -1, np.int64)
    angles = np.full(len(first.rays), np.inf)
    lines1 = (second.rays @ E)[:, :2]  # of each second feature, in the first picture
    for start in range(0, len(first.rays), ROWS):
        part = slice(start, start + ROWS)
        lines2 = first.rays[part] @ E.T
        scale = (lines2[:, :2] ** 2).sum(1)[:, None] + (lines1**2).sum(1)[None]
        near = (lines2 @ second.rays.T) ** 2 < tolerance**2 * scale
        cosine = first.descriptors[part] @ second.descriptors.T
        cosine[~near] = -1
        best = cosine.argmax(axis=1)
        rows = np.arange(len(best))
        angle = np.arccos(np.clip(cosine[rows, best], -1, 1))
        cosine[rows, best] = -1
        rival = np.arccos(np.clip(cosine.max(axis=1), -1, 1))
        good = near[rows, best] & (angle < distance) & (angle < ratio * rival)
        nearest[part] = np.where(good, best, -1)
        angles[part] = np.where(good, angle, np.inf)
    return nearest, angles


class PosedViews(Protocol):
    """V pictures of the scene at rest, composited over white, with their cameras."""

    @property
    def viewmats(self) -> np.ndarray:
        """Return [V, 4, 4] world-to-camera, OpenCV axes."""

    @property
    def Ks(self) -> np.ndarray:
        """Return [V, 3, 3] pixels."""

    @property
    def rgb(self) -> np.ndarray:
        """Return [V, H, W, 3] in 0..1."""

    @property
    def alpha(self) -> np.ndarray:
        """Return [V, H, W] in 0..1."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""


@dataclass(frozen=True)
class TriangulationConfig:
    """Thresholds for matches and points."""

    ratio: float = 0.8  # of the descriptor's angle to that of the second nearest on the epipolar line
    distance: float = 0.6  # radians between descriptors, at most
    epipolar_px: float = 1.0  # Sampson distance of a match, at most
    error_px: float = 2.0  # mean reprojection error of a point, at most
    min_angle_deg: float = 2.0  # between two rays of a point, at least
    max_axes_deg: float = 60.0  # between the optical axes of two pictures that are matched, at most
    neighbours: int = 24  # pictures each is matched with, the nearest ones; in small captures that is all
    seed: int = 0


def triangulate_views(views: PosedViews, config: TriangulationConfig = TriangulationConfig()) -> SfmPoints:
    """Points that at least three pictures show (two, where there are no more than three), in scene units.

    Poses and intrinsics are kept as they are. Features lie on the alpha masks only, and so do the points.
    One thread, and every random draw of COLMAP seeded: equal input gives equal points on one machine and version of
    pycolmap; other processors may differ in the last digits, and a feature at a threshold may come or go.
    Raises Tg4mmError without pycolmap. May find nothing: the caller judges whether the points are enough.
    """
    c = colmap("triangulation")
    c.set_random_seed(config.seed)
    with TemporaryDirectory(prefix="tg4mm-sfm-") as name:
        folder = Path(name)
        names = _write_pictures(folder, views)
        model = _known_model(c, views, names)
        _write_database(folder / "database.db", model)
        extract(folder / "database.db", folder / "images", names, folder / "masks")
        _match(c, folder / "database.db", views, config)
        with progress("triangulation", 1, "run") as update:
            found = c.triangulate_points(
                model, folder / "database.db", folder / "images", folder, options=_options(c, views, config)
            )
            points = _trusted(points_of(found), views, config)
            error = float(np.mean(points.errors_px)) if len(points) else 0.0
            update(1, points=len(points), error_px=error)
    return points


def _write_pictures(folder: Path, views: PosedViews) -> list[str]:
    """images/0000.png … and masks/0000.png.png …, white on the object, as COLMAP names them."""
    for part in ("images", "masks"):
        (folder / part).mkdir()
    names = []
    for i, (rgb, alpha) in enumerate(zip(views.rgb, views.alpha, strict=True)):
        names.append(f"{i:04d}.png")
        picture = (np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
        Image.fromarray(picture).save(folder / "images" / names[-1])
        mask = np.where(alpha > 0.5, 255, 0).astype(np.uint8)
        Image.fromarray(mask).save(folder / "masks" / f"{names[-1]}.png")
    return names


def _known_model(c: Any, views: PosedViews, names: list[str]) -> Any:
    """A pycolmap Reconstruction of pinholes at the known poses, picture i with camera and number i + 1."""
    model = c.Reconstruction()
    width, height = views.size
    for i, name in enumerate(names):
        K = views.Ks[i].astype(np.float64)
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        model.add_camera_with_trivial_rig(
            c.Camera(model="PINHOLE", width=width, height=height, params=params, camera_id=i + 1)
        )
        pose = c.Rigid3d(_rigid(views.viewmats[i])[:3])
        model.add_image_with_trivial_frame(c.Image(name=name, camera_id=i + 1, image_id=i + 1), pose)
    return model


def _rigid(viewmat: np.ndarray) -> np.ndarray:
    """The pose in float64, its rotation as orthonormal as that."""
    pose = viewmat.astype(np.float64)
    u, _, vt = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = u @ vt
    return pose


def _write_database(path: Path, model: Any) -> None:
    with opened(path) as db:
        for i in sorted(model.images):
            db.write_camera(model.cameras[i], use_camera_id=True)
            db.write_rig(model.rigs[i], use_rig_id=True)
            db.write_frame(model.frames[i], use_frame_id=True)
            db.write_image(model.images[i], use_image_id=True)


def view_pairs(viewmats: np.ndarray, max_axes_deg: float, neighbours: int) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, whose optical axes differ by at most max_axes_deg, each with its nearest neighbours.

    Nearest: by the angle of the axes, then by the cameras' distance, which orders parallel cameras.
    """
    rotations = viewmats[:, :3, :3].astype(np.float64)
    centres = -np.einsum("vji,vj->vi", rotations, viewmats[:, :3, 3].astype(np.float64))
    axes = rotations[:, 2]
    angle = np.degrees(np.arccos(np.clip(axes @ axes.T, -1, 1)))
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    rank = angle + 1e-3 * apart / max(apart.max(), 1e-12)
    pairs = set()
    for i in range(len(viewmats)):
        order = [j for j in np.argsort(rank[i], kind="stable") if j != i and angle[i, j] <= max_axes_deg]
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in order[:neighbours]}
    return sorted(pairs)


def _match(c: Any, path: Path, views: PosedViews, config: TriangulationConfig) -> None:
    """Guided matches of all pairs, written as verified ones."""
    viewmats = [_rigid(viewmat) for viewmat in views.viewmats]
    pairs = view_pairs(views.viewmats, config.max_axes_deg, config.neighbours)
    total = 0
    with opened(path) as db, progress("matching", len(pairs), "pairs") as update:
        features = [_features(db, i + 1, views.Ks[i]) for i in range(len(viewmats))]
        for done, (i, j) in enumerate(pairs, 1):
            E, relative = essential(viewmats[i], viewmats[j])
            norm = np.linalg.norm(relative[:, 3])
            if norm > 0:  # cameras at one place say nothing of depth
                focal = float((views.Ks[i, 0, 0] + views.Ks[j, 0, 0]) / 2)
                tolerance = config.epipolar_px / focal
                matches = guided_matches(
                    features[i], features[j], E / norm, tolerance, config.ratio, config.distance
                )
                if len(matches):
                    _write_matches(c, db, (i + 1, j + 1), E / norm, relative, matches)
                total += len(matches)
            update(done, matches=total)


def _features(db: Any, image_id: int, K: np.ndarray) -> Features:
    keypoints = np.asarray(db.read_keypoints(image_id), dtype=np.float64)
    descriptors = db.read_descriptors(image_id)
    data = np.asarray(getattr(descriptors, "data", descriptors))
    if keypoints.size == 0 or data.size == 0:
        keypoints, data = np.zeros((0, 2)), np.zeros((0, 128))
    return features_of(keypoints, data, K.astype(np.float64))


def _write_matches(
    c: Any, db: Any, ids: tuple[int, int], E: np.ndarray, relative: np.ndarray, matches: np.ndarray
) -> None:
    geometry = c.TwoViewGeometry()
    geometry.config = c.TwoViewGeometryConfiguration.CALIBRATED
    geometry.E = E
    geometry.cam2_from_cam1 = c.Rigid3d(relative)
    geometry.inlier_matches = matches
    db.write_two_view_geometry(*ids, geometry)


def _options(c: Any, views: PosedViews, config: TriangulationConfig) -> Any:
    options = c.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = config.seed
    options.min_num_matches = 1  # each match is verified by the known poses, however few a pair has
    options.triangulation.min_angle = options.mapper.filter_min_tri_angle = config.min_angle_deg
    options.triangulation.ignore_two_view_tracks = _fewest_views(views) > 2
    return options


def _fewest_views(views: PosedViews) -> int:
    """Return the least number of views: two rays always nearly meet on their epipolar lines, a third verifies."""
    return 3 if len(views.viewmats) > 3 else 2


def _trusted(points: SfmPoints, views: PosedViews, config: TriangulationConfig) -> SfmPoints:
    """Points with a small error; where masks cut an object out, those on it, in the space the cameras share."""
    masks = views.alpha > 0.5
    keep = (points.errors_px <= config.error_px) & (points.n_views >= _fewest_views(views))
    if not masks.all():
        viewmats, Ks = views.viewmats.astype(np.float64), views.Ks.astype(np.float64)
        centre, half = working_box(viewmats, Ks, views.size)
        keep &= np.abs(points.xyz - centre).max(axis=1, initial=0) <= half
        keep &= ~outside_masks(points.xyz.astype(np.float64), viewmats, Ks, masks)
    return points.kept(keep)
