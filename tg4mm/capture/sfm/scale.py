"""Metres per scene unit, from what was measured on the spot: two cameras' distance, or a length on the thing itself."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.sfm.dataset import Track
from tg4mm.capture.sfm.depth import Sight, Spot, depth_among_points, triangulated
from tg4mm.capture.sfm.points import Similarity
from tg4mm.capture.sfm.sources import SWEEP
from tg4mm.capture.sfm.staging import Shot, staged_name
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.extras import install
from tg4mm.core.untrusted import read_json, read_yaml

Pixel = tuple[str, float, float]  # a picture, and x and y in it: pixels from its left and upper edge
FORM = (
    '{"metres": 0.35, "points": [{"000.jpg": [210, 345.5], "008.jpg": [180, 350]}, {"000.jpg": [410, 350]}]}'
)


@dataclass(frozen=True)
class Length:
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


def read_length(path: Path) -> Length:
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
        return Length((first, second), float(values["metres"]))
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


def checked_length(length: Length) -> Length:
    """`length`. Raises Tg4mmError where it is no length above 0, or a coordinate is no number."""
    if not (math.isfinite(length.metres) and length.metres > 0):
        raise Tg4mmError(f"--length is {length.metres} m, expected a length above 0 m")
    for name, x, y in (*length.ends[0], *length.ends[1]):
        if not (math.isfinite(x) and math.isfinite(y)):
            raise Tg4mmError(f"--length: {name} has the position {x}, {y}, expected pixels")
    return length


def measured_length(
    length: Length, taken: Sequence[Shot], placed: Mapping[str, Any], model: Any, world: Similarity
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


def _located(end: tuple[Pixel, ...], taken: Sequence[Shot], placed: Mapping[str, Any], model: Any) -> Spot:
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


def _shot(name: str, taken: Sequence[Shot], placed: Mapping[str, Any]) -> Shot:
    """The placed picture that the user calls `name`: a file's name or stem, or a fixed camera's."""
    for shot in taken:
        names = {shot.name, shot.path.name, shot.path.stem}
        names |= {f"{SWEEP}_{shot.path.stem}"} if shot.clip == SWEEP else set()
        stem = (
            Path(name).stem if shot.name.startswith("cameras/") else name
        )  # cam_00.mp4 is the camera cam_00
        if name in names or stem in names:
            if staged_name(shot) not in placed:
                raise Tg4mmError(f"--length: {name} could not be placed")
            return shot
    known = ", ".join(shot.path.name for shot in taken[:6])
    raise Tg4mmError(f"--length names {name}, which is no picture; there are {known} …")


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
            raise Tg4mmError(f"--baseline names {name}, which is no placed camera; there are {known} …")
        viewmat = still[key].viewmats[0]
        found.append(-viewmat[:3, :3].T @ viewmat[:3, 3])
    apart = float(np.linalg.norm(found[0] - found[1]))
    if apart < 1e-6:
        raise Tg4mmError(f"--baseline: {ends[0]} and {ends[1]} are at the same place")
    return metres / apart
