"""Metres per scene unit, from what was measured on the spot: two cameras' distance, or a length on the thing itself.

The ends of that length are located from several pictures of each, or from known points around it. One picture gives
the ray. On a plane, inverse depth is affine in the position on the plane z = 1, so the points around the pixel are
fitted by one, robustly, and the ray's depth is read off it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.sfm.clip import SWEEP
from tg4mm.capture.sfm.dataset import Track
from tg4mm.capture.sfm.place import Similarity
from tg4mm.capture.sfm.staging import StagedPicture, staged_name
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.extras import install
from tg4mm.core.untrusted import read_json, read_yaml

Pixel = tuple[str, float, float]  # a picture, and x and y in it: pixels from its left and upper edge
FORM = (
    '{"metres": 0.35, "points": [{"000.jpg": [210, 345.5], "008.jpg": [180, 350]}, {"000.jpg": [410, 350]}]}'
)

CLICK_PX = 1.0  # standard deviation of a place that a person points at
AROUND = 24  # nearest points that the plane is laid through, at most
FEWEST = 6
NEAR = 0.08  # of the picture's longer side: how far off they may be
SHALLOWEST_DEG = 1.0  # between two sights of a point
MISFIT_PX = 10.0  # by which sights of one point may miss it
TUKEY = 4.685  # standard deviations, for an efficiency of 95 %


@dataclass(frozen=True)
class Sight:
    """A pixel of a placed picture."""

    name: str  # as the user calls the picture
    image: Any  # pycolmap Image
    camera: Any  # pycolmap Camera
    pixel: np.ndarray  # [2]

    @property
    def pose(self) -> np.ndarray:
        """Return [3, 4] camera from world."""
        return np.asarray(self.image.cam_from_world().matrix())

    @property
    def ray(self) -> np.ndarray:
        """Return the direction [3] of the pixel, camera axes, z = 1."""
        return np.append(np.asarray(self.camera.cam_from_img(self.pixel)).ravel()[:2], 1.0)

    @property
    def angle(self) -> float:
        """CLICK_PX on the plane z = 1."""
        return CLICK_PX / float(self.camera.mean_focal_length())


@dataclass(frozen=True)
class Spot:
    """A point in space and how well it is known."""

    xyz: np.ndarray  # [3]
    covariance: np.ndarray  # [3, 3]


@dataclass(frozen=True)
class KnownLength:
    """A distance in metres between two points, each seen in one or more pictures."""

    ends: tuple[tuple[Pixel, ...], tuple[Pixel, ...]]
    metres: float


@dataclass(frozen=True)
class MeasuredLength:
    """A measured length in the dataset's world."""

    points: np.ndarray  # [2, 3] scene units
    units: float  # between them
    metres: float
    uncertainty_percent: float  # of the length, one standard deviation

    @property
    def unit_scale_m(self) -> float:
        """Metres per scene unit."""
        return self.metres / self.units

    def record(self) -> dict[str, Any]:
        """Return the record for scene.json."""
        return {
            "points": np.round(self.points, 6).tolist(),
            "units": round(self.units, 6),
            "metres": self.metres,
            "uncertainty_percent": round(self.uncertainty_percent, 2),
        }


def read_length(path: Path) -> KnownLength:
    """A length from a JSON or YAML file: `metres`, and `points`, two of them, each {picture: [x, y], …}.

    Raises Tg4mmError for a file that is missing, malformed, or of another form.
    """
    try:
        values = read_json(path) if path.suffix.lower() == ".json" else read_yaml(path)
    except OSError as error:
        raise Tg4mmError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ImportError as error:
        raise Tg4mmError(f"a YAML file needs PyYAML ({error}): {install('sfm')}, or write JSON") from None
    except ValueError as error:
        raise Tg4mmError(f"{path}: cannot be parsed: {' '.join(str(error).split())}") from error
    try:
        first, second = (_seen(point) for point in values["points"])
        return KnownLength((first, second), float(values["metres"]))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise Tg4mmError(f"{path}: has an unknown form; expected {FORM}") from None


def _seen(point: Mapping[str, Sequence[float]]) -> tuple[Pixel, ...]:
    pixels = []
    for name, place in point.items():
        x, y = place
        pixels.append((str(name), float(x), float(y)))
    if not pixels:
        raise ValueError("a point without pictures")
    return tuple(pixels)


def checked_length(length: KnownLength) -> KnownLength:
    """`length`. Raises Tg4mmError where it is no length above 0, or a coordinate is no number."""
    if not (math.isfinite(length.metres) and length.metres > 0):
        raise Tg4mmError(f"--length is {length.metres} m, expected a length above 0 m")
    for name, x, y in (*length.ends[0], *length.ends[1]):
        if not (math.isfinite(x) and math.isfinite(y)):
            raise Tg4mmError(f"--length: {name} has the position {x}, {y}, expected pixels")
    return length


def measured_length(
    length: KnownLength,
    taken: Sequence[StagedPicture],
    placed: Mapping[str, Any],
    model: Any,
    world: Similarity,
) -> MeasuredLength:
    """The length in the dataset's world. Raises Tg4mmError for a picture that is not there, or a place without depth.

    taken, placed: the pictures and the pycolmap Images of those placed, by name; model: the Reconstruction.
    """
    spots = [_located(end, taken, placed, model) for end in length.ends]
    units = float(np.linalg.norm(spots[0].xyz - spots[1].xyz))
    if units * world.scale < 1e-6:
        raise Tg4mmError("--length: both ends are the same point")
    along = (spots[0].xyz - spots[1].xyz) / units
    variance = along @ (spots[0].covariance + spots[1].covariance) @ along
    return MeasuredLength(
        points=world.points(np.stack([spot.xyz for spot in spots])),
        units=units * world.scale,
        metres=length.metres,
        uncertainty_percent=100 * math.sqrt(max(float(variance), 0.0)) / units,
    )


def _located(
    end: tuple[Pixel, ...], taken: Sequence[StagedPicture], placed: Mapping[str, Any], model: Any
) -> Spot:
    """Locate a point: by triangulation from several pictures, or by surrounding points in a single one."""
    sights = []
    for name, x, y in end:
        shot = _shot(name, taken, placed)
        image = placed[staged_name(shot)]
        camera = model.cameras[image.camera_id]
        width, height = shot.upright((camera.width, camera.height))
        if not (0 <= x <= width and 0 <= y <= height):
            raise Tg4mmError(f"--length: {name} is {width}×{height} pixels, {x:g}, {y:g} lies outside")
        for _ in range(-shot.turns % 4):  # turned on until it lies as it is stored
            x, y, width, height = y, width - x, height, width
        sights.append(Sight(name, image, camera, np.array([x, y])))
    return triangulated(sights) if len(sights) > 1 else depth_among_points(sights[0], model)


def _shot(name: str, taken: Sequence[StagedPicture], placed: Mapping[str, Any]) -> StagedPicture:
    """The placed picture that the user calls `name`: a file's name or stem, or a fixed camera's."""
    for shot in taken:
        names = {shot.name, shot.path.name, shot.path.stem}
        names |= {f"{SWEEP}_{shot.path.stem}"} if shot.clip == SWEEP else set()
        # cam_00.mp4 is the camera cam_00
        stem = Path(name).stem if shot.name.startswith("cameras/") else name
        if name in names or stem in names:
            if staged_name(shot) not in placed:
                raise Tg4mmError(f"--length: {name} could not be placed")
            return shot
    known = ", ".join(shot.path.name for shot in taken[:6])
    raise Tg4mmError(f"--length names {name}, which is not a picture; there are {known} …")


def baseline_scale(tracks: Sequence[Track], baseline: tuple[str, str, float]) -> float:
    """Metres per unit from the distance of two cameras (or photographs) in metres.

    Raises Tg4mmError where one is not placed, moves, or both are at the same place.
    """
    *ends, metres = baseline
    still = {track.name: track for track in tracks if (track.viewmats == track.viewmats[0]).all()}
    found = []
    for name in ends:
        stem = Path(name).stem
        key = next((key for key in (name, stem, f"{SWEEP}_{stem}") if key in still), None)
        if key is None:
            known = ", ".join(list(still)[:8])
            raise Tg4mmError(f"--baseline names {name}, which is not a placed camera; there are {known} …")
        viewmat = still[key].viewmats[0]
        found.append(-viewmat[:3, :3].T @ viewmat[:3, 3])
    apart = float(np.linalg.norm(found[0] - found[1]))
    if apart < 1e-6:
        raise Tg4mmError(f"--baseline: {ends[0]} and {ends[1]} are at the same place")
    return metres / apart


def triangulated(sights: Sequence[Sight], steps: int = 10) -> Spot:
    """The point that two or more pictures show: Gauss–Newton on the distances on the planes z = 1.

    Raises Tg4mmError where the rays are nearly parallel, miss each other, or meet behind a picture.
    """
    centres = np.stack([-s.pose[:, :3].T @ s.pose[:, 3] for s in sights])
    rays = np.stack([s.pose[:, :3].T @ s.ray for s in sights])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    widest = np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1)))
    names = ", ".join(s.name for s in sights)
    if widest < SHALLOWEST_DEG:
        raise Tg4mmError(
            f"--length: {names} see the point in directions {widest:.2f}° apart, too close for depth; "
            "mark it in another picture"
        )
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    xyz = np.linalg.solve(across.sum(0), np.einsum("sij,sj->i", across, centres))
    for _ in range(steps):
        residual, jacobian = _equations(sights, xyz)
        xyz = xyz - np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    residual, jacobian = _equations(sights, xyz)
    miss = float(np.linalg.norm(residual.reshape(-1, 2), axis=1).max()) * CLICK_PX
    if not miss <= MISFIT_PX:
        raise Tg4mmError(
            f"--length: the pixels given in {names} do not show the same point: they are up to {miss:.0f} pixels off; "
            "mark the point again"
        )
    if behind := [s.name for s in sights if s.pose[2, :3] @ xyz + s.pose[2, 3] <= 0]:
        raise Tg4mmError(
            f"--length: {names} meet behind {behind[0]}: are the pixels those of these pictures, in this order?"
        )
    return Spot(
        xyz, np.linalg.inv(jacobian.T @ jacobian) * max(1.0, float(residual @ residual) / len(residual))
    )


def _equations(sights: Sequence[Sight], xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals [2 S] in standard deviations of a click, and their derivatives [2 S, 3] by the point."""
    residuals, rows = [], []
    for sight in sights:
        cam = sight.pose[:, :3] @ xyz + sight.pose[:, 3]
        residuals.append((cam[:2] / cam[2] - sight.ray[:2]) / sight.angle)
        projection = np.array([[1, 0, -cam[0] / cam[2]], [0, 1, -cam[1] / cam[2]]]) / cam[2]
        rows.append(projection @ sight.pose[:, :3] / sight.angle)
    return np.concatenate(residuals), np.concatenate(rows)


def depth_among_points(sight: Sight, model: Any) -> Spot:
    """The point of one picture's pixel, on the plane through the points found around it.

    Raises Tg4mmError where there are too few, or the plane does not face the camera.
    """
    pose = sight.pose
    seen = [p for p in sight.image.points2D if p.has_point3D()]
    pixels = np.array([p.xy for p in seen]).reshape(-1, 2)
    reach = NEAR * max(sight.camera.width, sight.camera.height)
    distance = np.linalg.norm(pixels - sight.pixel, axis=1)
    order = [int(i) for i in np.argsort(distance)[:AROUND] if distance[i] <= reach]
    if len(order) < FEWEST:
        raise Tg4mmError(
            f"--length: {len(order)} points are known within {reach:.0f} pixels of {sight.pixel[0]:g}, "
            f"{sight.pixel[1]:g} in {sight.name}, at least {FEWEST} are needed; mark it in a second picture"
        )
    xyz = np.array([model.points3D[seen[i].point3D_id].xyz for i in order])
    cam = xyz @ pose[:, :3].T + pose[:, 3]
    inverse, spread = _plane(cam[:, :2] / cam[:, 2:] - sight.ray[:2], 1 / cam[:, 2])
    if inverse <= 2 * spread:
        raise Tg4mmError(
            f"--length: the points around {sight.pixel[0]:g}, {sight.pixel[1]:g} in {sight.name} lie on no surface; "
            "mark it in a second picture"
        )
    depth = 1 / inverse
    covariance = np.diag([(sight.angle * depth) ** 2] * 2 + [0.0])
    covariance += np.outer(sight.ray, sight.ray) * (spread * depth**2) ** 2
    turned = pose[:, :3].T @ covariance @ pose[:, :3]
    return Spot(pose[:, :3].T @ (depth * sight.ray - pose[:, 3]), turned)


def _plane(offsets: np.ndarray, inverse: np.ndarray, rounds: int = 10) -> tuple[float, float]:
    """Inverse depth at offset 0 and its standard deviation, of an affine fit to `inverse` [M] at `offsets` [M, 2].

    From the triple of points whose plane has the least median residual (Rousseeuw 1984), Tukey's weights.
    """
    A = np.concatenate([np.ones((len(offsets), 1)), offsets], axis=1)
    triples = np.array(list(combinations(range(len(A)), 3)))
    planes = np.linalg.pinv(A[triples], rcond=1e-4) @ inverse[triples][..., None]
    medians = np.median(np.abs(A @ planes - inverse[:, None])[..., 0], axis=1)
    solution = planes[int(medians.argmin()), :, 0]
    for _ in range(rounds):
        residual = np.abs(inverse - A @ solution)
        sigma = 1.4826 * float(np.median(residual)) * np.sqrt(len(A) / max(len(A) - 3, 1))
        weights = np.maximum(0.0, 1 - (residual / (TUKEY * max(sigma, 1e-12))) ** 2) ** 2
        normal = np.linalg.pinv(A.T @ (weights[:, None] * A))
        solution = normal @ (A.T @ (weights * inverse))
    return float(solution[0]), sigma * float(np.sqrt(max(normal[0, 0], 0.0)))
