"""The spiral of NeRF-synthetic: many cameras around the scene at every timestep.

The formula is that of the script which rendered NeRF-synthetic: a camera at (0, 4, 0.5) looks at the origin
and hangs on an empty that is turned about z by twice the step of its tilt about x. The empty's angles are
float32 in Blender and sums of steps drift by 1e-6; the drift is reproduced, so poses agree with [3DMM]'s
files to 1e-6.
"""

from __future__ import annotations

import numpy as np

from .camera import ORIGINAL, Aim, Camera

_BASE_ELEVATION = float(np.arctan2(0.5, 4.0))
_TEST_PATH = 10  # views of the published test path; fewer are chosen from it


def spiral(n_views: int, tilt: float, start: float, aim: Aim = ORIGINAL) -> list[Camera]:
    """Two turns of azimuth from 90° + `start`, elevation 7.1° + (0 … `tilt`); angles in radians."""
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


def train_cameras(n_views: int, aim: Aim = ORIGINAL) -> list[Camera]:
    """Training views; 30 of them are exactly those of the published data."""
    return spiral(n_views, 0.7, 0.0, aim)


def test_cameras(n_views: int, aim: Aim = ORIGINAL) -> list[Camera]:  # noqa: PT028 (it is no test)
    """Test views: spread over the published path of 10, numbered as in it; above 10 a path of their own."""
    start = np.radians(15.0)
    if n_views > _TEST_PATH:
        return spiral(n_views, 0.6, start, aim)
    path = spiral(_TEST_PATH, 0.6, start, aim)
    return [path[i * _TEST_PATH // n_views] for i in range(n_views)]
