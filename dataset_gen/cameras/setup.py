"""Which cameras take the pictures: one frozen description, and the cameras of every timestep that follow."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from ..errors import GenerateError
from .camera import CAMERA_ANGLE_X, DISTANCE, Aim, Camera
from .handheld import beside_path, fixed_camera, handheld_camera, sweep_cameras
from .orbit import test_cameras, train_cameras
from .rig import rig_cameras

KINDS = ("orbit", "rig", "sweep", "handheld", "given")
_FARTHEST = 1e5  # scene units
_FASTEST = 1e6  # Hz
_MARGIN = 1.08  # of the distance at which a sphere around the scene just fits the picture


@dataclass(frozen=True)
class CameraSetup:
    """The cameras of a dataset and its clock. Raises GenerateError on construction if a value is unusable.

    Kinds, training cameras: `orbit`, `views` on the published spiral at every timestep; `rig`, `views` fixed
    ones on arcs, each with its own lens; `sweep`, one fixed camera, and at timestep 0 also `views` of a
    hand-held sweep; `handheld`, one moving camera, whatever `views` says; `given`, those in `given`.
    Test cameras are fixed: those of the orbit, but beside its path for `handheld`.
    """

    kind: str = "orbit"
    views: int = 30  # training cameras at timestep 0, less the fixed one of a sweep
    test_views: int = 5
    n_timesteps: int = 30
    fps: float = 30.0  # timesteps per second, Hz
    seed: int = 0  # of what varies by chance: lenses, tremor
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # looked at, scene units
    distance: float = DISTANCE  # from the centre, scene units
    angle_x: float = CAMERA_ANGLE_X  # horizontal field of view, radians
    given: tuple[Camera, ...] = ()  # of kind "given" alone

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise GenerateError(f"--cameras {self.kind!r} is none of {', '.join(KINDS)}")
        _whole("--views", self.views, 1, 1000)
        _whole("--test-views", self.test_views, 0, 1000)
        if self.kind == "orbit" and self.views == 2:
            raise GenerateError(
                "--views 2: on the orbit both would stand in the same place; 1, or 3 and more"
            )
        _whole("--timesteps", self.n_timesteps, 1, 1000)  # folders are numbered with three digits
        _whole("--seed", self.seed, 0, 2**31 - 1)
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise GenerateError(f"--fps {self.fps!r} is not a positive number")
        if not 1e-3 <= self.fps <= _FASTEST:
            raise GenerateError(f"--fps {self.fps!r} is not in 0.001 … {_FASTEST:g} Hz")
        if len(self.centre) != 3 or not all(abs(x) <= _FARTHEST for x in self.centre):
            raise GenerateError(f"the cameras' centre {self.centre!r} is not three numbers of up to 1e5")
        if not 0 < self.distance <= _FARTHEST:
            raise GenerateError(f"the cameras' distance {self.distance!r} is not in 0 … 1e5 scene units")
        if not 0.001 <= self.angle_x <= 2.9:
            raise GenerateError(f"the field of view {self.angle_x!r} is not in 0.001 … 2.9 radians")
        if [camera.index for camera in self.given] != list(range(len(self.given))):
            raise GenerateError(f"given cameras are numbered {[c.index for c in self.given]}, not 0, 1, …")

    def placed(self, centre: Sequence[float], radius: float, cameras: Sequence[Camera] = ()) -> CameraSetup:
        """The same cameras around a scene that fills a sphere (scene units); `cameras` found in it, if given.

        Raises GenerateError if kind is "given" and there are none, or if the sphere has no size.
        """
        if not (math.isfinite(radius) and radius > 0):
            raise GenerateError(f"the scene has a radius of {radius!r}: there is nothing to look at")
        if self.kind == "given" and not cameras:
            raise GenerateError("--cameras given: the file holds no camera")
        return replace(
            self,
            centre=(float(centre[0]), float(centre[1]), float(centre[2])),
            distance=_MARGIN * radius / math.sin(0.5 * self.angle_x),
            given=tuple(c.numbered(i) for i, c in enumerate(cameras)) if self.kind == "given" else (),
        )

    @property
    def aim(self) -> Aim:
        return Aim(self.centre, self.distance, self.angle_x)

    def n_train(self, timestep: int) -> int:
        """Training cameras at a timestep."""
        sweep = self.views if timestep == 0 else 0
        return {"sweep": 1 + sweep, "handheld": 1, "given": len(self.given)}.get(self.kind, self.views)

    def to_json(self) -> dict[str, Any]:
        """Plain data; `from_json` gives an equal setup."""
        data = asdict(replace(self, given=()))
        return {**data, "centre": list(self.centre), "given": [camera.to_json() for camera in self.given]}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> CameraSetup:
        x, y, z = data["centre"]
        given = tuple(Camera.from_json(camera) for camera in data["given"])
        return cls(**{**data, "centre": (x, y, z), "given": given})


def cameras_at(setup: CameraSetup, timestep: int) -> dict[str, tuple[Camera, ...]]:
    """The cameras of splits "train" and "test" at a timestep, 0 … n_timesteps − 1.

    A camera that stands still compares and hashes equal at any two timesteps, and has the same name.
    """
    if not 0 <= timestep < setup.n_timesteps:
        raise ValueError(f"timestep {timestep} is not in 0 … {setup.n_timesteps - 1}")
    if setup.kind == "given" and not setup.given:
        raise GenerateError("--cameras given needs a scene of your own (--blend FILE) that holds cameras")
    moves = setup.kind == "handheld"
    begins = setup.kind == "sweep" and timestep == 0
    return {"train": _train(setup, timestep if moves else 0, begins), "test": _test(setup)}


@functools.lru_cache(maxsize=1024)
def _train(setup: CameraSetup, timestep: int, begins: bool) -> tuple[Camera, ...]:
    if setup.kind == "orbit":
        return tuple(train_cameras(setup.views, setup.aim))
    if setup.kind == "rig":
        return tuple(rig_cameras(setup.views, setup.aim, setup.seed))
    if setup.kind == "sweep":
        sweep = sweep_cameras(setup.views, setup.aim, setup.seed) if begins else ()
        return (fixed_camera(setup.aim), *sweep)
    if setup.kind == "handheld":
        return (handheld_camera(timestep / setup.fps, setup.fps, setup.aim, setup.seed),)
    return setup.given


@functools.lru_cache(maxsize=32)
def _test(setup: CameraSetup) -> tuple[Camera, ...]:
    if not setup.test_views:
        return ()
    if setup.kind == "handheld":
        duration = (setup.n_timesteps - 1) / setup.fps
        return tuple(beside_path(setup.test_views, duration, setup.aim, setup.seed))
    return tuple(test_cameras(setup.test_views, setup.aim))


def _whole(option: str, value: int, low: int, high: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise GenerateError(f"{option} {value!r} is not a whole number in {low} … {high}")
