"""Lenses whose bend the pictures do not ask for, taken for pinholes: those pictures stay as they are, not resampled.

A few pictures determine a lens badly: bend, focal length and depth trade places with hardly any change of the
reprojection error. Phones straighten their videos themselves, so the simpler lens is the better guess where it will do.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from tg4mm.sfm.engine import colmap

STRAIGHT_PX = 0.5  # bend of a lens that is taken for a pinhole whatever the others are
GROWTH = 0.05  # of the sum of squared reprojection errors, for which all lenses are
SAMPLES = 33  # places looked at along each side of the picture


def bend_px(camera: Any) -> float:
    """The largest distance, within the picture, between where a pycolmap Camera and its pinhole see the same ray."""
    u, v = np.meshgrid(np.linspace(0, camera.width, SAMPLES), np.linspace(0, camera.height, SAMPLES))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = np.asarray(camera.cam_from_img(pixels))
    K = np.asarray(camera.calibration_matrix())
    straight = rays[:, :2] * [K[0, 0], K[1, 1]] + K[:2, 2]
    return float(np.linalg.norm(straight - pixels, axis=1).max())


def straightened(model: Any, threads: int) -> Any:
    """The pycolmap Reconstruction with pinholes for all lenses, if those explain the pictures as well.

    Else for lenses that bend less than STRAIGHT_PX, the others kept. Focal lengths, poses and points are adjusted;
    `model` is left as it is.
    """
    bent = [i for i, camera in model.cameras.items() if not camera.is_undistorted()]
    if not bent:
        return model
    straight = _with_pinholes(model, bent, threads)
    if squared_error(straight) <= (1 + GROWTH) * squared_error(model):
        return straight
    slight = [i for i in bent if bend_px(model.cameras[i]) <= STRAIGHT_PX]
    return _with_pinholes(model, slight, threads) if slight else model


def squared_error(model: Any) -> float:
    """Sum of squared reprojection errors over all observations, as far as each point's mean error tells."""
    model.update_point_3d_errors()
    return float(sum(point.error**2 * point.track.length() for point in model.points3D.values()))


def _with_pinholes(model: Any, cameras: list[int], threads: int) -> Any:
    model = copy.deepcopy(model)
    for i in cameras:
        params = np.array(model.cameras[i].params)
        params[list(model.cameras[i].extra_params_idxs())] = 0
        model.cameras[i].params = params
    adjust(model, threads, focal=True)
    return model


def adjust(model: Any, threads: int, focal: bool) -> None:
    """Bundle adjustment of all placed pictures and points, in place; of lenses the focal length at most."""
    c = colmap("tg4mm sfm")
    options = c.BundleAdjustmentOptions()
    options.refine_focal_length, options.refine_extra_params = focal, False
    options.print_summary = False
    options.ceres.solver_options.num_threads = threads
    config = c.BundleAdjustmentConfig()
    for i in model.reg_image_ids():
        config.add_image(i)
    config.fix_gauge(c.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    c.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()
