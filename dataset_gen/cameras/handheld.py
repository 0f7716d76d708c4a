"""Hand-held paths: a sweep around the scene before the recording, and one camera that is never put down."""

from __future__ import annotations

import numpy as np

from .camera import Aim, Camera
from .hand import Tremor, held

_FRONT = np.pi / 2  # azimuth at which the orbit starts too
_FIXED_ELEVATION = np.radians(18.0)  # of the tripod after the sweep
_SWEEP_RATE = 2.0  # views per second: a walk around the scene
_SWEEP_LOW, _SWEEP_HIGH = np.radians(8.0), np.radians(42.0)
_SPEED = np.radians(15.0)  # of the drift, per second
_SWING = np.radians(40.0)  # how far the drift goes to either side
_HELD_ELEVATION, _HELD_RISE = np.radians(20.0), np.radians(5.0)
_TEST_OFF = np.radians(3.0)  # test views lie this far above or below the path


def fixed_camera(aim: Aim) -> Camera:
    """The camera on its tripod, number 0 at every timestep."""
    return aim.look_from(0, aim.place(_FRONT, float(_FIXED_ELEVATION)))


def sweep_cameras(n: int, aim: Aim, seed: int) -> list[Camera]:
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


def handheld_camera(time_s: float, fps: float, aim: Aim, seed: int) -> Camera:
    """The one camera at a time in seconds: it drifts at up to 15° per second, 40° to either side."""
    return held(Tremor.of(seed, fps), time_s, 0, aim, aim.place(*drift(seed, time_s)))


def beside_path(n: int, duration_s: float, aim: Aim, seed: int) -> list[Camera]:
    """`n` fixed test cameras along the hand-held path, alternately 3° above and below it.

    Views from the far side of the scene, which the hand-held camera never saw, could not be asked for.
    """
    cameras = []
    for i in range(n):
        azimuth, elevation, nearness = drift(seed, duration_s * (i + 0.5) / n)
        raised = elevation + float(_TEST_OFF if i % 2 == 0 else -_TEST_OFF)
        cameras.append(aim.look_from(i, aim.place(azimuth, raised, nearness)))
    return cameras
