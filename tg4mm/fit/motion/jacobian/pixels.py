"""What a motion does in the pictures to first order: how far things move in pixels, its optical flow, depth."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tg4mm.capture.tracking.template import slope
from tg4mm.fit.motion.jacobian.packed import DOF, mean_rows, mean_rows_as_colours
from tg4mm.fit.motion.jacobian.view import PosedView, ViewJacobian
from tg4mm.fit.rasterize.buffers import Buffers

PERCENT = 99.0  # of the visible Gaussians: outliers of a fit must not decide
_CAMERAS = 8  # views looked at, spread evenly


def pixels_moved(views: Sequence[ViewJacobian], shifts: np.ndarray) -> np.ndarray:
    """[S]: the 99th percentile over visible Gaussians, in up to eight views, of image motion; 0 if none is visible.

    S shifts [S, N, 3] in scene units, projected to first order.
    """
    some = np.unique(np.linspace(0, len(views) - 1, _CAMERAS).round().astype(int))
    lengths = np.concatenate([_lengths(views[k], shifts) for k in some], 1)
    if not lengths.size:
        return np.zeros(len(shifts))
    return np.asarray(np.percentile(lengths, PERCENT, axis=1))


def _lengths(view: ViewJacobian, shifts: np.ndarray) -> np.ndarray:
    """[S, n] pixels."""
    right, down = mean_rows(view.packed)
    own = shifts[:, view.bins.order[: view.bins.n_visible]]
    return np.asarray(np.hypot(*(np.einsum("nd,snd->sn", row, own) for row in (right, down))))


def optical_flow(view: ViewJacobian, motions: np.ndarray, buffers: Buffers) -> np.ndarray:
    """[R, H, W, 3] of motions [R, N, DOF]: right and down in pixels, then 0. Valid until the next call with `buffers`.

    Each pixel sums the flow of its Gaussians' means by blending weight; the background's flow is 0.
    """
    return replace(view, packed=mean_rows_as_colours(view.packed)).jvp(motions, buffers)


def false_changes(
    view: ViewJacobian, mean: np.ndarray, motions: np.ndarray, is_flat: bool = True
) -> np.ndarray:
    """[R, H, W, 3]: of the change by motions [R, N, DOF] what the scene at rest has and `mean` [H, W, 3] lacks.

    Of a flat capture it corrects the answer, by slopes exact for fine texture; else it is in the ± alone, whose
    calibration has central differences.
    """
    error = view.over_white - mean
    down, right = ((slope(error, axis) if is_flat else np.gradient(error, axis=axis)) for axis in (0, 1))
    flow = optical_flow(view, motions, Buffers())
    # a motion to the right by a pixel takes away the slope to the right
    return np.asarray(-(flow[..., :1] * right + flow[..., 1:2] * down))


def along_and_across(camera: PosedView, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors [N, 3] from the camera to the points `means` [N, 3], and across these, along the pictures' rows."""
    rotation, translation = camera.viewmat[:3, :3].astype(np.float64), camera.viewmat[:3, 3]
    along = _unit(means + rotation.T @ translation)  # from the camera's centre −Rᵀt
    return along, _unit(np.cross(along, rotation[1]))


def _unit(v: np.ndarray) -> np.ndarray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))


def depth_sensitivity(view: ViewJacobian, camera: PosedView, means: np.ndarray, seed: int = 0) -> float:
    """Change of the picture (rms) for motion towards the camera over that for motion across, same lengths.

    means [N, 3] in scene units. Signs are random from Gaussian to Gaussian, so that nothing cancels but by chance.
    0 where no motion across is seen.
    """
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (len(means), 1))
    motions = np.zeros((2, len(means), DOF), np.float32)
    motions[..., :3] = signs * np.stack(along_and_across(camera, means))
    along, across = np.sqrt((view.jvp(motions).astype(np.float64) ** 2).sum((1, 2, 3)))
    return float(along / across) if across > 0 else 0.0
