"""The camera setup: one frozen description, and the cameras of every timestep that follow from it."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..errors import GenerateError, check_choice, check_whole, check_within
from . import paths
from .camera import CAMERA_ANGLE_X, DISTANCE, Aim, SceneCamera

_FARTHEST = 1e5  # scene units
_FASTEST = 1e6  # Hz
_MARGIN = 1.08  # of the distance at which a sphere around the scene just fits the picture
_DIGITS = 6  # of a second
_SHORTEST_PAUSE, _LONGEST_PAUSE = 2.0, 10.0  # seconds between clips: the camera is carried to its next place


@dataclass(frozen=True)
class CameraSetup:
    """The cameras of a dataset and its clock. Raises GenerateError on construction if a value is unusable.

    Kinds, training cameras: `orbit`, `views` on the published spiral at every timestep; `rig`, `views` fixed
    ones on arcs, each with its own lens; `sweep`, one fixed camera, and beside its first picture also `views` of
    a hand-held sweep around the scene at rest; `handheld`, one moving camera, whatever `views` says; `clips`, one
    camera that films from `views` places one after another; `flat`, one fixed camera; `given`, those in `given`.
    Test cameras are fixed: those of the orbit, but beside its path for `handheld`, and its own for `flat`.
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
    given: tuple[SceneCamera, ...] = ()  # of kind "given" alone
    clock_offset_s: float = 0.0  # how far the clocks of cameras that film together are off at most, seconds
    # training cameras other than the orbit's stand this many times as far away (`framing`)
    clearance: float = 1.0
    test_clearance: float = 1.0  # and so do test cameras, of which flat has none of its own

    def __post_init__(self) -> None:
        check_choice("--cameras", self.kind, KINDS)
        check_whole("--views", self.views, 1, 1000)
        check_whole("--test-views", self.test_views, 0, 1000)
        if self.kind == "orbit" and self.views == 2:
            raise GenerateError(
                "--views 2: on the orbit both would stand in the same place; 1, or 3 and more"
            )
        check_whole("--timesteps", self.n_timesteps, 1, 1000)  # folders are numbered with three digits
        check_whole("--seed", self.seed, 0, 2**31 - 1)
        check_within("--fps", self.fps, 1e-3, _FASTEST, "Hz")
        if len(self.centre) != 3 or not all(abs(x) <= _FARTHEST for x in self.centre):
            raise GenerateError(f"the cameras' centre {self.centre!r} is not three numbers of up to 1e5")
        check_within("the cameras' distance", self.distance, 0, _FARTHEST, "scene units", above=True)
        check_within("the field of view", self.angle_x, 0.001, 2.9, "radians")
        check_within("--clock-offsets", self.clock_offset_s, 0, 1e4, "seconds")
        if self.clock_offset_s and not KINDS[self.kind].together:
            raise GenerateError(
                f"--clock-offsets {self.clock_offset_s:g}: with --cameras {self.kind} no two cameras film at once"
            )
        if [camera.index for camera in self.given] != list(range(len(self.given))):
            raise GenerateError(f"given cameras are numbered {[c.index for c in self.given]}, not 0, 1, …")

    def placed(
        self, centre: Sequence[float], radius: float, cameras: Sequence[SceneCamera] = ()
    ) -> "CameraSetup":
        """The same cameras around a scene that fills a sphere (scene units); `cameras` found in it, if given.

        Raises GenerateError if kind is "given" and there are none, or if the sphere has no size.
        """
        if not 0 < radius < math.inf:
            raise GenerateError(f"the scene has a radius of {radius!r}: there is nothing to look at")
        if self.kind == "given" and not cameras:
            raise GenerateError("--cameras given: the file holds no camera")
        return replace(
            self,
            centre=(float(centre[0]), float(centre[1]), float(centre[2])),
            distance=_MARGIN * radius / math.sin(0.5 * self.angle_x),
            given=tuple(c.numbered(i) for i, c in enumerate(cameras)) if self.kind == "given" else (),
        )

    def framing(self, points: np.ndarray, magnified: np.ndarray | None = None) -> "CameraSetup":
        """The same, moved back until training cameras have all `points` [P, 3] in their pictures.

        Test cameras, which also take the magnified pictures, have `magnified` [P, 3] too. Not the orbit, whose places
        are published, nor given cameras.
        """
        if self.kind == "orbit":
            return self
        times = range(self.n_timesteps) if self.kind == "handheld" else (0,)

        def train(clearance: float) -> list[SceneCamera]:
            setup = replace(self, clearance=clearance)
            return [camera for t in times for camera in cameras_at(setup, t)["train"]]

        def test(clearance: float) -> list[SceneCamera]:
            return list(cameras_at(replace(self, test_clearance=clearance), 0)["test"])

        framed = self
        if self.kind != "given":
            framed = replace(framed, clearance=paths.farther(points, train))
        if self.kind != "flat":
            seen = points if magnified is None else np.concatenate([points, magnified])
            framed = replace(framed, test_clearance=paths.farther(seen, test))
        return framed

    @property
    def aim(self) -> Aim:
        """Target, distance and lens of the orbit."""
        return Aim(self.centre, self.distance, self.angle_x)

    @property
    def stand(self) -> Aim:
        """Target, distance and lens of the other training cameras."""
        return Aim(self.centre, self.distance * self.clearance, self.angle_x)

    @property
    def test_stand(self) -> Aim:
        """Target, distance and lens of the test cameras."""
        return Aim(self.centre, self.distance * self.test_clearance, self.angle_x)

    def n_train(self, timestep: int) -> int:
        """Training cameras at a timestep."""
        sweep = self.views if timestep == 0 else 0
        own = {"sweep": 1 + sweep, "handheld": 1, "flat": 1, "given": len(self.given)}
        return own.get(self.kind, self.views)

    @property
    def n_test(self) -> int:
        """Test cameras."""
        return min(self.test_views, 1) if self.kind == "flat" else self.test_views

    @property
    def capture_kind(self) -> str:
        """The kind of capture that scene.json names: photos, flat, tripod, handheld, rig or clips."""
        if self.n_timesteps == 1:
            return "photos"
        if KINDS[self.kind].together and self.n_train(0) == 1:
            return "flat"
        return KINDS[self.kind].capture

    def to_json(self) -> dict[str, Any]:
        """Plain data; `from_json` gives an equal setup."""
        data = asdict(replace(self, given=()))
        if self.test_clearance == 1.0:  # as in sets that were made before there was one
            del data["test_clearance"]
        return {**data, "centre": list(self.centre), "given": [camera.to_json() for camera in self.given]}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "CameraSetup":
        x, y, z = data["centre"]
        given = tuple(SceneCamera.from_json(camera) for camera in data["given"])
        return cls(**{**data, "centre": (x, y, z), "given": given})


def cameras_at(setup: CameraSetup, timestep: int) -> dict[str, tuple[SceneCamera, ...]]:
    """The cameras of splits "train" and "test" at a timestep, 0 … n_timesteps − 1.

    A camera that stands still compares and hashes equal at any two timesteps, and has the same name.
    """
    if not 0 <= timestep < setup.n_timesteps:
        raise ValueError(f"timestep {timestep} is not in 0 … {setup.n_timesteps - 1}")
    if setup.kind == "given" and not setup.given:
        raise GenerateError("--cameras given needs a scene of your own (--blend FILE) that holds cameras")
    # Of equal cameras one tuple is kept: all timesteps but the first are alike unless the camera moves.
    shown = timestep if setup.kind == "handheld" else min(timestep, 1)
    return {"train": _train(setup, shown), "test": _test(setup)}


class CameraKind(NamedTuple):
    """A way to film a scene."""

    label: str
    about: str  # a few words for the command line and the panel
    capture: str  # the kind that scene.json names, of a capture of several timesteps
    # Training cameras of a setup at a timestep.
    train: Callable[[CameraSetup, int], Sequence[SceneCamera]]
    single: bool = False  # takes no number of views
    together: bool = False  # cameras film at the same time, each with a clock


def _sweep(setup: CameraSetup, timestep: int) -> Sequence[SceneCamera]:
    round_ = () if timestep else paths.sweep_cameras(setup.views, setup.stand, setup.seed)
    return (paths.fixed_camera(setup.stand), *round_)


KINDS = {
    "orbit": CameraKind(
        "Orbit", "NeRF-synthetic's spiral", "rig", lambda s, t: paths.train_cameras(s.views, s.aim), together=True
    ),
    "rig": CameraKind(
        "Rig", "fixed, around the scene", "rig", lambda s, t: paths.rig_cameras(s.views, s.stand, s.seed), together=True
    ),
    "sweep": CameraKind("Sweep", "one fixed, after a handheld round", "tripod", _sweep),
    "handheld": CameraKind(
        "Hand-Held", "one, all along", "handheld",
        lambda s, t: (paths.handheld_camera(t / s.fps, s.fps, s.stand, s.seed),), single=True,
    ),
    "clips": CameraKind(
        "Clips", "one, from place after place", "clips", lambda s, t: paths.clip_cameras(s.views, s.stand, s.seed)
    ),
    "flat": CameraKind("Flat", "one fixed", "flat", lambda s, t: (paths.fixed_camera(s.stand),), single=True),
    "given": CameraKind(
        "The Scene's Own", "those of the .blend file", "rig", lambda s, t: s.given, single=True, together=True
    ),
}  # fmt: skip


@functools.lru_cache(maxsize=1024)
def _train(setup: CameraSetup, timestep: int) -> tuple[SceneCamera, ...]:
    return tuple(KINDS[setup.kind].train(setup, timestep))


@functools.lru_cache(maxsize=32)
def _test(setup: CameraSetup) -> tuple[SceneCamera, ...]:
    if not setup.test_views:
        return ()
    if setup.kind == "flat":
        return (paths.fixed_camera(setup.stand),)
    if setup.kind == "handheld":
        duration = (setup.n_timesteps - 1) / setup.fps
        return tuple(paths.beside_path(setup.test_views, duration, setup.test_stand, setup.seed))
    return tuple(paths.test_cameras(setup.test_views, setup.test_stand))


def scene_time(setup: CameraSetup, camera: SceneCamera, timestep: int) -> float | None:
    """Return the scene time in seconds of a training picture, or None if the scene is at rest.

    The scene's clock is the one that the exact motion and the test views go by, and it is camera 0's: a time that all
    clocks are off by cannot be known from pictures. On its camera's own clock a picture is taken at timestep / fps, as
    the pose file says; the offset only the truth says.
    """
    if not films(setup, camera):
        return None
    return timestep / setup.fps + clock_offsets(setup)[camera.index]


def films(setup: CameraSetup, camera: SceneCamera) -> bool:
    """Return whether a training camera records over time; sweep pictures show the scene before it moves."""
    return setup.kind != "sweep" or camera.index == 0


@functools.lru_cache(maxsize=64)
def clock_offsets(setup: CameraSetup) -> tuple[float, ...]:
    """Seconds from the scene's clock to that of each camera that films, the first 0.

    Cameras that were not started together differ by up to `clock_offsets` either way. Clips follow one another
    with pauses of 2 to 10 seconds, so that each has a phase of its own at every frequency.
    """
    count = 1 if setup.kind == "sweep" else setup.n_train(0)
    rng = np.random.default_rng([setup.seed, 0xC10C])
    if setup.kind == "clips":
        length = setup.n_timesteps / setup.fps
        pauses = rng.uniform(_SHORTEST_PAUSE, _LONGEST_PAUSE, count - 1)
        offsets = np.cumsum([0.0, *(length + pauses)])
    else:
        offsets = np.array([0.0, *rng.uniform(-setup.clock_offset_s, setup.clock_offset_s, count - 1)])
    return tuple((offsets.round(_DIGITS) + 0.0).tolist())
