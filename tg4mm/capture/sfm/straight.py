"""Lenses that may as well be pinholes, taken for such: their pictures then stay as they are, not resampled.

Bend, focal length and shape of the scene trade places with hardly any change of the reprojection error, and a bend
takes up errors that all pictures share. Phones straighten their videos themselves, so the pinhole is the better guess
where the features, which lie where there is texture, do not object to it.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from tg4mm.capture.sfm.engine import colmap
from tg4mm.core.progress import progress

GROWTH = 0.05  # of the sum of squared reprojection errors, up to which all lenses are taken for pinholes
SLIGHT_PX = 0.5  # largest bend of a lens that is taken for one whatever the others are
STEPS = 50  # of an adjustment, as COLMAP's mapper takes
TOLERANCE = 1e-6  # relative change of the squared error at which it ends


def straightened(model: Any, threads: int) -> Any:
    """The pycolmap Reconstruction with pinholes for all lenses, if those explain the pictures as well.

    Else for lenses that bend less than SLIGHT_PX, the others kept. Focal lengths, poses and points are adjusted;
    `model` is left as it is.
    """
    bent = [i for i, camera in model.cameras.items() if not camera.is_undistorted()]
    if not bent:
        return model
    straight = _with_pinholes(model, bent, threads)
    if squared_error(straight) <= (1 + GROWTH) * squared_error(model):
        return straight
    slight = [i for i in bent if bend_px(model.cameras[i]) <= SLIGHT_PX]
    return _with_pinholes(model, slight, threads) if slight else model


def bend_px(camera: Any) -> float:
    """The largest distance at the picture's corners and edges between what a camera and its pinhole see."""
    w, h = camera.width, camera.height
    pixels = np.array([(x * w, y * h) for x in (0, 0.5, 1) for y in (0, 0.5, 1) if (x, y) != (0.5, 0.5)])
    rays = np.asarray(camera.cam_from_img(pixels))
    K = np.asarray(camera.calibration_matrix())
    straight = rays[:, :2] * [K[0, 0], K[1, 1]] + K[:2, 2]
    return float(np.linalg.norm(straight - pixels, axis=1).max())


def squared_error(model: Any) -> float:
    """Sum of squared reprojection errors over all observations, as far as each point's mean error tells."""
    model.update_point_3d_errors()
    return float(sum(point.error**2 * point.track.length() for point in model.points3D.values()))


def adjust(model: Any, threads: int) -> None:
    """Bundle adjustment of all placed pictures and points, in place; of lenses the focal length alone.

    COLMAP does not tell how far it is, so only the time that passes is shown.
    """
    c = colmap("tg4mm sfm")
    options = c.BundleAdjustmentOptions()
    options.refine_extra_params = options.print_summary = False
    solver = options.ceres.solver_options
    solver.num_threads, solver.max_num_iterations, solver.function_tolerance = threads, STEPS, TOLERANCE
    with progress("adjusting", 1, "run", brief=True) as update:
        c.bundle_adjustment(
            model, options
        )  # an adjuster's own `solve` would stop all other threads of Python
        model.update_point_3d_errors()
        update(1, error_px=float(model.compute_mean_reprojection_error()))


def _with_pinholes(model: Any, cameras: list[int], threads: int) -> Any:
    model = copy.deepcopy(model)
    for i in cameras:
        params = np.array(model.cameras[i].params)
        params[list(model.cameras[i].extra_params_idxs())] = 0
        model.cameras[i].params = params
    adjust(model, threads)
    return model
