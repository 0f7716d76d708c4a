"""Paths of cameras: the published spiral, a rig, clips, a sweep by hand, one never put down; what they frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .camera import ORIGINAL, Aim, SceneCamera

PLACE_RMS = 0.0015  # of the distance to the scene: 1.5 mm at one metre, per axis
TURN_RMS = float(np.radians(0.1))  # per axis
_LOWEST, _HIGHEST = 0.2, 8.0  # Hz: below is drift, which the path has; above, a hand holding weight is still
_NYQUIST_SHARE = 0.4  # of the frame rate: faster tremor would jump from frame to frame
_TONES = 40
_FRONT = np.pi / 2  # azimuth at which the orbit starts too
_FIXED_ELEVATION = np.radians(18.0)  # of the tripod after the sweep
_SWEEP_RATE = 2.0  # views per second: a walk around the scene
_SPEED = np.radians(15.0)  # of the drift, per second
_SWING = np.radians(40.0)  # how far the drift goes to either side
_TEST_OFF = np.radians(3.0)  # test views lie this far above or below the path
_BASE_ELEVATION = float(np.arctan2(0.5, 4.0))
_TEST_PATH = 10  # views of the published test path; fewer are chosen from it
_ROWS = ((6, (20.0,)), (16, (12.0, 38.0)), (1000, (10.0, 30.0, 52.0)))  # up to so many cameras: elevations, °
_LENS = 0.05  # fields of view differ by up to this fraction: lenses of one type do
_PLACE = np.radians(1.5)  # and nobody mounts a camera to the degree
_DEPTH = 0.02  # of the distance
_INSIDE = 0.96  # of the picture's half width: pixel filters, and a hand that shakes, need a little room
_STEP = 1.01
_MOST = 300  # steps, 20 times as far
_DIRECTIONS = 400
_SWEEP_LOW, _SWEEP_HIGH = np.radians(8.0), np.radians(42.0)
_HELD_ELEVATION, _HELD_RISE = np.radians(20.0), np.radians(5.0)


@dataclass(frozen=True, eq=False)
class Tremor:
    """Six channels of noise over time: three of place, three of turn, each with an rms of 1.

    A sum of tones at frequencies that are spread evenly over the octaves. Their amplitudes fall as 1/√f, so
    the amplitude density over frequency falls as 1/f, as that of hand-held cameras does, and fade to nothing over
    the last quarter of the band.
    """

    frequencies_hz: np.ndarray  # [6, K]
    amplitudes: np.ndarray  # [6, K]
    phases: np.ndarray  # [6, K], radians

    @classmethod
    def of(
        cls, seed: int | tuple[int, ...], fps: float, band_hz: tuple[float, float] = (_LOWEST, _HIGHEST)
    ) -> "Tremor":
        """Tremor for pictures at `fps` Hz: in a band, by default up to 8 Hz, never above 0.4 of the frame rate."""
        rng = np.random.default_rng([*(seed if isinstance(seed, tuple) else (seed,)), 0x4A2D])
        highest = min(band_hz[1], _NYQUIST_SHARE * fps)
        lowest = min(band_hz[0], highest / 8.0)
        spread = (np.arange(_TONES) + rng.random((6, _TONES))) / _TONES
        frequencies = lowest * (highest / lowest) ** spread
        fade = np.clip((highest - frequencies) / (0.25 * highest), 0.0, 1.0)
        amplitudes = frequencies**-0.5 * (0.5 - 0.5 * np.cos(np.pi * fade))
        amplitudes *= np.sqrt(2.0 / (amplitudes**2).sum(1, keepdims=True))
        return cls(frequencies, amplitudes, rng.uniform(0.0, 2 * np.pi, (6, _TONES)))

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Place [3] and turn [3] at a time in seconds, dimensionless."""
        tones = np.sin(2 * np.pi * self.frequencies_hz * time_s + self.phases)
        channels = (self.amplitudes * tones).sum(1)
        return channels[:3], channels[3:]


def held(tremor: Tremor, time_s: float, index: int, aim: Aim, place: np.ndarray) -> SceneCamera:
    """The camera that a hand holds at `place` [3] and aims at the centre."""
    moved, turn = tremor.at(time_s)
    steady = aim.look_from(index, place)
    pose = steady.camera_to_world.copy()
    pose[:3, 3] += PLACE_RMS * aim.distance * moved
    pose[:3, :3] = pose[:3, :3] @ rotation_matrix(TURN_RMS * turn)
    return replace(steady, camera_to_world=pose)


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """Return [3, 3] of a rotation vector [3], radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def fixed_camera(aim: Aim) -> SceneCamera:
    """The camera on its tripod, number 0 at every timestep."""
    return aim.look_from(0, aim.place(_FRONT, float(_FIXED_ELEVATION)))


def sweep_cameras(n: int, aim: Aim, seed: int) -> list[SceneCamera]:
    """`n` views of a walk once around the scene with the camera raised and lowered twice, numbered from 1."""
    tremor = Tremor.of(seed, 30.0)  # of a hand, whatever the recording's rate
    lag, reach = np.random.default_rng([seed, 0x53EE]).uniform(0.0, 2 * np.pi, 2)
    cameras = []
    for i in range(n):
        part = (i + 0.5) / n
        height = 0.5 - 0.5 * np.cos(4 * np.pi * part + 0.3 * np.sin(2 * np.pi * part + lag))
        elevation = _SWEEP_LOW + (_SWEEP_HIGH - _SWEEP_LOW) * height
        azimuth = _FRONT + 2 * np.pi * part + 0.06 * np.sin(6 * np.pi * part + lag)
        nearness = 1.0 + 0.06 * np.sin(2 * np.pi * part + reach)
        place = aim.place(float(azimuth), float(elevation), float(nearness))
        cameras.append(held(tremor, i / _SWEEP_RATE, i + 1, aim, place))
    return cameras


def drift(seed: int, time_s: float) -> tuple[float, float, float]:
    """Azimuth and elevation (radians) of the hand-held camera at a time, and its distance as a factor."""
    rise, reach = np.random.default_rng([seed, 0xD21F]).uniform(0.0, 2 * np.pi, 2)
    azimuth = _FRONT + _SWING * np.sin(_SPEED * time_s / _SWING)
    elevation = _HELD_ELEVATION + _HELD_RISE * np.sin(2 * np.pi * 0.13 * time_s + rise)
    return float(azimuth), float(elevation), float(1.0 + 0.03 * np.sin(2 * np.pi * 0.19 * time_s + reach))


def handheld_camera(time_s: float, fps: float, aim: Aim, seed: int) -> SceneCamera:
    """The one camera at a time in seconds: it drifts at up to 15° per second, 40° to either side."""
    return held(Tremor.of(seed, fps), time_s, 0, aim, aim.place(*drift(seed, time_s)))


def beside_path(n: int, duration_s: float, aim: Aim, seed: int) -> list[SceneCamera]:
    """`n` fixed test cameras along the hand-held path, alternately 3° above and below it.

    Views from the far side of the scene, which the hand-held camera never saw, could not be asked for.
    """
    cameras = []
    for i in range(n):
        azimuth, elevation, nearness = drift(seed, duration_s * (i + 0.5) / n)
        raised = elevation + float(_TEST_OFF if i % 2 == 0 else -_TEST_OFF)
        cameras.append(aim.look_from(i, aim.place(azimuth, raised, nearness)))
    return cameras


def spiral(n_views: int, tilt: float, start: float, aim: Aim = ORIGINAL) -> list[SceneCamera]:
    """Two turns of azimuth from 90° + `start`, elevation 7.1° + (0 … `tilt`); angles in radians.

    The formula of the script that rendered NeRF-synthetic: a camera at (0, 4, 0.5) looks at the origin and hangs on an
    empty that is turned about z by twice the step of its tilt about x. The empty's angles are float32 in Blender and
    sums of steps drift by 1e-6; the drift is reproduced, so poses agree with [3DMM]'s files to 1e-6.
    """
    step = 2.0 * np.pi / n_views
    azimuth = np.float32(start)
    cameras = []
    for i in range(n_views):
        if i:
            azimuth = np.float32(azimuth + 2.0 * step)
        # View 0 has the start tilt; from then on the tilt lags one step behind, as in the original.
        raised = tilt if i == 0 else tilt * (1.0 + np.cos(step * (i - 1))) / 2.0
        elevation = _BASE_ELEVATION + float(np.float32(raised))
        cameras.append(aim.look_from(i, aim.place(float(azimuth) + np.pi / 2.0, elevation), step))
    return cameras


def train_cameras(n_views: int, aim: Aim = ORIGINAL) -> list[SceneCamera]:
    """Training views; 30 of them are exactly those of the published data."""
    return spiral(n_views, 0.7, 0.0, aim)


def test_cameras(n_views: int, aim: Aim = ORIGINAL) -> list[SceneCamera]:  # noqa: PT028 (it is no test)
    """Test views: spread over the published path of 10, numbered as in it; above 10 a path of their own."""
    start = np.radians(15.0)
    if n_views > _TEST_PATH:
        return spiral(n_views, 0.6, start, aim)
    path = spiral(_TEST_PATH, 0.6, start, aim)
    return [path[i * _TEST_PATH // n_views] for i in range(n_views)]


def rig_cameras(n: int, aim: Aim, seed: int) -> list[SceneCamera]:
    """`n` cameras on arcs at one to three elevations, fewer cameras on the higher ones.

    Fields of view lie within 5 % of the aim's, places within 1.5° and 2 % of the regular ones.
    """
    return _mounted(n, aim, np.random.default_rng([seed, 0x716]), _LENS)


def clip_cameras(n: int, aim: Aim, seed: int) -> list[SceneCamera]:
    """One camera in `n` places, as those of a rig; its lens stays the same."""
    return _mounted(n, aim, np.random.default_rng([seed, 0xC11F]), 0.0)


def _mounted(n: int, aim: Aim, rng: np.random.Generator, spread: float) -> list[SceneCamera]:
    cameras: list[SceneCamera] = []
    for azimuth, elevation in _places(n):
        off = rng.uniform(-1.0, 1.0, 4)
        lens = replace(aim, angle_x=aim.angle_x * (1.0 + spread * float(off[3])))
        place = aim.place(azimuth + _PLACE * off[0], elevation + _PLACE * off[1], 1.0 + _DEPTH * off[2])
        cameras.append(lens.look_from(len(cameras), place))
    return cameras


def _places(n: int) -> list[tuple[float, float]]:
    """Azimuth and elevation of every camera, radians, row by row from below."""
    elevations = np.radians(next(rows for most, rows in _ROWS if n <= most))
    edges = np.concatenate([[0.0], np.cumsum(np.cos(elevations))])
    cuts = np.round(edges / edges[-1] * n).astype(int)  # as many per row as its circle is long
    places = []
    for row, elevation in enumerate(elevations):
        count = int(cuts[row + 1] - cuts[row])
        start = np.pi / 2 + row * np.pi / max(count, 1)  # rows are staggered
        places += [(start + 2 * np.pi * i / count, float(elevation)) for i in range(count)]
    return places


def farther(points: np.ndarray, cameras: Callable[[float], Sequence[SceneCamera]]) -> float:
    """The least factor from 1 in steps of 1 % for which `cameras(factor)` have all `points` [P, 3] in their pictures.

    Pictures are square.
    """
    hull = extreme_points(points)
    clearance = 1.0
    for _ in range(_MOST):
        if all(half_widths(camera, hull) <= _INSIDE for camera in cameras(clearance)):
            break
        clearance *= _STEP
    return round(clearance, 6)


def half_widths(camera: SceneCamera, points: np.ndarray) -> float:
    """Return the largest distance of the projected points [P, 3] from the picture's centre, in half widths.

    Infinite if one lies behind the camera.
    """
    pixels, depth = camera.project(points, 2, 2)
    return float(np.abs(pixels - 1.0).max()) if (depth > 0).all() else float("inf")


def extreme_points(points: np.ndarray) -> np.ndarray:
    """Return the points of [P, 3] that are extreme in one of 400 directions spread evenly over the sphere."""
    return points[np.unique([int((points @ direction).argmax()) for direction in _directions()])]


def moving_points(points: np.ndarray, basis: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Return [400, 3]: the farthest place that any of the points comes to at any time, in each of 400 directions.

    Parameters: `points` [P, 3] at rest; `basis` [G, P, 3], real shapes of their displacement; `gains` [G, T], of the
    shapes over time.
    """
    most = np.abs(gains).max(axis=1, initial=0.0)

    def farthest(direction: np.ndarray) -> np.ndarray:
        still, shapes = points @ direction, basis @ direction
        ends = most @ np.abs(shapes)
        may = np.flatnonzero(still + ends >= (still - ends).max())  # no other point can come first
        along = still[may, None] + shapes[:, may].T @ gains
        point, time = np.unravel_index(along.argmax(), along.shape)
        return points[may[point]] + gains[:, time] @ basis[:, may[point]]

    return np.array([farthest(direction) for direction in _directions()])


def _directions() -> np.ndarray:
    """Return [400, 3] unit vectors."""
    turns = np.arange(_DIRECTIONS) + 0.5
    z, azimuth = 1.0 - 2.0 * turns / _DIRECTIONS, turns * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
