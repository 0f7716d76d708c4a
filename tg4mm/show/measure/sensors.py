"""Virtual sensors: a name and a region of the scene, as an option `NAME=box:…` or in a small YAML file."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.capture.cameras import FARTHEST
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.regions import Regions
from tg4mm.core.untrusted import read_yaml

_NAME = re.compile(r"[^\W_][\w.+-]*( [\w.+-]+)*")  # a file's name is made of it
_FORMS = {
    "all": "all",
    "box": "box:X0,Y0,Z0,X1,Y1,Z1",
    "sphere": "sphere:X,Y,Z,RADIUS",
    "pixel": "pixel:CAMERA,X,Y[,RADIUS]",
    "polygon": "polygon:CAMERA,X,Y,X,Y,X,Y[,X,Y …]",
    "cluster": "cluster:NUMBER or cluster:still",
}
OF_PICTURE = "pixel", "polygon"  # regions of a camera's picture
PIXEL_RADIUS = 4.0  # pixels
_LONGEST = 60  # characters of a value in a message
STILL = 0  # number of the static cluster


class MeasureError(Tg4mmError):
    """A sensor that cannot be read, has no Gaussian, or is in no picture."""


@dataclass(frozen=True)
class Sensor:
    """A region of Gaussians that is measured as one rigid body.

    region `all`: every Gaussian. `box`: values are two corners (6, scene units). `sphere`: centre and radius (4, scene
    units). `pixel`: x, y, radius in pixels of the training view `camera` (3; x to the right, y down, from the upper
    left corner), and the surface that is seen there. `polygon`: x, y of three corners or more, the same. `cluster`:
    values hold the number of a cluster that moves alike,
    as the default sensors are numbered from 1; 0 is what stands still.
    """

    name: str  # letters, digits, _ . + - and single spaces, at most 64
    region: str  # all, box, sphere, pixel, polygon or cluster
    values: tuple[float, ...] = ()  # the numbers of the region, see above
    camera: str = ""  # of a pixel or polygon: name of a training view's first picture, without suffix

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or len(self.name) > 64:
            raise MeasureError(
                f"sensor name {self.name!r}: expected letters, digits, '_', '.', '+', '-' and single spaces, at most 64"
            )
        if self.region not in _FORMS:
            raise MeasureError(f"sensor {self.name}: region {self.region!r} is none of {', '.join(_FORMS)}")
        corners = max(6, len(self.values) // 2 * 2)
        count = {"all": 0, "box": 6, "sphere": 4, "pixel": 3, "polygon": corners, "cluster": 1}[self.region]
        if len(self.values) != count or not all(math.isfinite(v) for v in self.values):
            raise MeasureError(
                f"sensor {self.name}: {self.region} has the numbers {list(self.values)}, expected {_FORMS[self.region]}"
            )
        self._check_values()

    def _check_values(self) -> None:
        v = self.values
        if self.region == "box" and not all(a < b for a, b in zip(v[:3], v[3:], strict=True)):
            raise MeasureError(
                f"sensor {self.name}: box {list(v)}: each of X0, Y0, Z0 must be below X1, Y1, Z1"
            )
        if self.region in ("sphere", "pixel") and v[-1] <= 0:
            raise MeasureError(f"sensor {self.name}: radius {v[-1]:g} must be above 0")
        if max(map(abs, v), default=0) > FARTHEST:
            raise MeasureError(f"sensor {self.name}: {max(map(abs, v)):g} is beyond {FARTHEST:g}")
        if self.region in OF_PICTURE and not self.camera:
            raise MeasureError(f"sensor {self.name}: expected {_FORMS[self.region]}, a camera is missing")
        if self.region == "cluster" and (v[0] < 0 or v[0] != int(v[0])):
            raise MeasureError(
                f"sensor {self.name}: cluster number {v[0]:g} must be a whole number of at least 0"
            )

    def __str__(self) -> str:
        if self.region == "all":
            return f"{self.name}=all"
        if self.region == "cluster":
            return f"{self.name}=cluster:{int(self.values[0]) or 'still'}"
        numbers = ",".join(f"{v:g}" for v in self.values)
        return f"{self.name}={self.region}:{f'{self.camera},' if self.camera else ''}{numbers}"


def parse_sensor(text: str) -> Sensor:
    """Parse a sensor, as `tg4mm measure --sensor` takes it.

    Args:
        text: `[NAME=]REGION`, REGION one of `all`, `box:…`, `sphere:…`, `pixel:…`, `cluster:…` (`Sensor`).

    Returns:
        The sensor; without a name it is called after its region.

    Raises:
        MeasureError: the text is none, with what was expected.
    """
    name, equals, rest = text.partition("=")
    if not equals:
        name, rest = "", text
    region, _, numbers = rest.strip().partition(":")
    parts = [p.strip() for p in numbers.split(",")] if numbers else []
    return _sensor(name.strip(), region.strip(), parts, f"--sensor {text!r}")


def read_sensors(path: Path | str) -> list[Sensor]:
    """Read the sensors of a YAML file: a list, or `sensors:` with one, of mappings with `name` and one region.

    For instance `{name: tip, sphere: [0, 0, 1.2, 0.1]}`, `{name: wall, pixel: [cam_00, 320, 96, 12]}`, `{name: rest,
    cluster: still}`, `{name: whole, all: true}`. Raises MeasureError with the file, the entry and the offending value.
    """
    path = Path(path)
    try:
        found = read_yaml(path)
    except ValueError as error:
        raise MeasureError(f"{path}: {error}") from None
    entries = found.get("sensors") if isinstance(found, dict) else found
    if not isinstance(entries, list) or not entries:
        raise MeasureError(f"{path}: expected a list of sensors, or 'sensors:' with one")
    sensors = [_of_entry(entry, f"{path}, sensor {k + 1}") for k, entry in enumerate(entries)]
    try:
        return checked_names(sensors)
    except MeasureError as error:
        raise MeasureError(f"{path}: {error}") from None


def drawn_sensors(regions: Regions, cameras: Sequence[str], names: Sequence[str] = ()) -> list[Sensor]:
    """Sensors on regions of a file; `names`: these alone. Those that name no camera are of the only one.

    Raises MeasureError where there are several, RegionError for a name that is none.
    """
    out = []
    for region in [regions[name] for name in names] or regions.regions:
        if not region.camera and len(cameras) != 1:
            raise MeasureError(
                f"region {region.name!r} names no camera, and there are {len(cameras)}: {', '.join(cameras[:8])}"
            )
        camera = region.camera or cameras[0]
        if region.shape == "point":
            out.append(Sensor(region.name, "pixel", region.values, camera))
        else:
            out.append(Sensor(region.name, "polygon", tuple(region.corners.ravel().tolist()), camera))
    return checked_names(out)


def file_name(name: str) -> str:
    """Return a sensor's name as a part of a file's name."""
    return re.sub(r"[^\w.+-]+", "_", name)


def checked_names(sensors: Sequence[Sensor]) -> list[Sensor]:
    """Return the sensors. Raises MeasureError if two have one name, or would share a file, as `a b` and `A_b`."""
    names: set[str] = set()
    for sensor in sensors:
        own = file_name(sensor.name).lower()
        if own in names:
            raise MeasureError(f"two sensors are called {sensor.name!r}: give each another name")
        names.add(own)
    return list(sensors)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def _of_entry(entry: Any, where: str) -> Sensor:
    if not isinstance(entry, dict):
        raise MeasureError(f"{where}: {_short(entry)} is no mapping with a name and a region")
    regions = [key for key in entry if key in _FORMS]
    if unknown := [key for key in entry if key not in _FORMS and key != "name"]:
        raise MeasureError(f"{where}: {_short(unknown[0])} is unknown; there are: name, {', '.join(_FORMS)}")
    if len(regions) != 1:
        raise MeasureError(f"{where}: has {len(regions)} regions, expected one of {', '.join(_FORMS)}")
    value = entry[regions[0]]
    parts = [] if regions[0] == "all" else value if isinstance(value, list) else [value]
    return _sensor(str(entry.get("name", "")), regions[0], [str(p) for p in parts], where)


def _sensor(name: str, region: str, parts: list[str], where: str) -> Sensor:
    if region not in _FORMS:
        raise MeasureError(f"{where}: {region!r} is no region; there are: {'; '.join(_FORMS.values())}")
    camera = ""
    if region in OF_PICTURE and parts:
        camera, parts = parts[0], parts[1:]
    if region == "pixel" and len(parts) == 2:
        parts = [*parts, f"{PIXEL_RADIUS:g}"]
    if region == "cluster" and parts == ["still"]:
        parts = [str(STILL)]
    values: tuple[float, ...] = ()
    for part in parts:
        try:
            values += (float(part),)
        except ValueError:
            raise MeasureError(f"{where}: {part!r} is not a number, expected {_FORMS[region]}") from None
    try:
        return Sensor(name or _default_name(region, camera, values), region, values, camera)
    except MeasureError as error:
        raise MeasureError(f"{where}: {error}") from None


def _default_name(region: str, camera: str, values: tuple[float, ...]) -> str:
    if region == "all":
        return "all"
    named = [camera, *(f"{v:g}" for v in values)] if camera else [f"{v:g}" for v in values]
    return f"{region} {'_'.join(named)}"[:64]
