"""Fixed cameras on arcs around the scene: a rig, each with a lens of its own, or one camera's places for clips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .camera import Aim, Camera

_ROWS = ((6, (20.0,)), (16, (12.0, 38.0)), (1000, (10.0, 30.0, 52.0)))  # up to so many cameras: elevations, °
_LENS = 0.05  # fields of view differ by up to this fraction: lenses of one type do
_PLACE = np.radians(1.5)  # and nobody mounts a camera to the degree
_DEPTH = 0.02  # of the distance


def rig_cameras(n: int, aim: Aim, seed: int) -> list[Camera]:
    """`n` cameras on arcs at one to three elevations, fewer cameras on the higher ones.

    Fields of view lie within 5 % of the aim's, places within 1.5° and 2 % of the regular ones.
    """
    return _mounted(n, aim, np.random.default_rng([seed, 0x716]), _LENS)


def clip_cameras(n: int, aim: Aim, seed: int) -> list[Camera]:
    """One camera in `n` places, as those of a rig; its lens stays the same."""
    return _mounted(n, aim, np.random.default_rng([seed, 0xC11F]), 0.0)


def _mounted(n: int, aim: Aim, rng: np.random.Generator, spread: float) -> list[Camera]:
    cameras: list[Camera] = []
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
