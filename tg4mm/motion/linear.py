"""How images answer to small motions: the Jacobian of rendering at rest, forward and transposed.

Per view and Gaussian an 8 × 6 matrix takes displacement and rotation to the projected splat (mean, conic,
colour); the blending kernels do the rest. Nothing is approximated but the motion's smallness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import float32, njit, prange

from tg4mm.gaussians import Gaussians
from tg4mm.motion.differences import FixedCamera
from tg4mm.rasterize.kernels.binning import Bins, bin_splats, gather_gradient
from tg4mm.rasterize.kernels.blend import blend_backward, blend_forward, blend_tangent
from tg4mm.rasterize.kernels.layout import ALPHA_MIN, CA, CB, CC, FEAT, FEATURES, MX, MY, SPLAT_WIDTH
from tg4mm.rasterize.kernels.project import empty_splats, pack_camera, project_backward, project_forward
from tg4mm.space.view import EPS2D, FAR, NEAR

# A picture's cut-off at 1/255 takes the rim off every Gaussian. The rim moves along: as a step, of which a derivative
# inside the rim knows nothing. That would make faint Gaussians answer too weakly (by 1/255 over their opacity), so the
# Jacobian is taken with hardly any cut-off.
ALPHA_MIN_LINEAR = ALPHA_MIN / 30
DOF = 6  # displacement (scene units) and rotation vector (radians, world axes)
_COLUMNS = np.array([MX, MY, CA, CB, CC, FEAT, FEAT + 1, FEAT + 2])


@njit(parallel=True, fastmath=True, cache=True)
def _push(jacobian, rows, columns, motion, d_splats):
    for k in prange(len(rows)):
        i = rows[k]
        for c in range(len(columns)):
            total = float32(0.0)
            for d in range(motion.shape[1]):
                total += jacobian[k, c, d] * motion[i, d]
            d_splats[i, columns[c]] = total


@njit(parallel=True, fastmath=True, cache=True)
def _pull(jacobian, rows, columns, v_splats, v_motion):
    for k in prange(len(rows)):
        i = rows[k]
        for d in range(v_motion.shape[1]):
            total = float32(0.0)
            for c in range(len(columns)):
                total += jacobian[k, c, d] * v_splats[i, columns[c]]
            v_motion[i, d] += total


@dataclass(frozen=True)
class RestView:
    """One camera's picture of the Gaussians at rest and its Jacobian."""

    splats: np.ndarray  # [N, SPLAT_WIDTH]
    bins: Bins
    image: np.ndarray  # [H, W, FEATURES]
    transmittance: np.ndarray  # [H, W]
    jacobian: np.ndarray  # [n_visible, 8, DOF] float32, in the order of bins.order

    @property
    def _rows(self) -> np.ndarray:
        return self.bins.order[: self.bins.n_visible]

    def push(self, motion: np.ndarray) -> np.ndarray:
        """[N, DOF] float32 -> change of the picture over white [H, W, 3]."""
        height, width = self.transmittance.shape
        d_splats = np.zeros((len(motion), FEAT + 3), np.float32)
        _push(self.jacobian, self._rows, _COLUMNS, motion, d_splats)
        out = np.empty((height, width, 4), np.float32)
        bins = self.bins
        blend_tangent(
            self.splats, d_splats, bins.tile_start, bins.pair_gaussian, width, height, out, ALPHA_MIN_LINEAR
        )
        return out[..., :3] + out[..., 3:]

    def pull(self, picture: np.ndarray, v_motion: np.ndarray) -> None:
        """The transpose: adds to `v_motion` [N, DOF] what a picture [H, W, 3] says."""
        height, width = self.transmittance.shape
        v_image = np.zeros((height, width, FEATURES), np.float32)
        v_image[..., :3] = picture
        v_pairs = np.empty((len(self.bins.pair_gaussian), FEAT + FEATURES), np.float32)
        bins = self.bins
        blend_backward(
            self.splats, bins.tile_start, bins.pair_gaussian, width, height,
            self.image, self.transmittance, v_image, np.ascontiguousarray(picture.sum(-1)), v_pairs, ALPHA_MIN_LINEAR,
        )  # fmt: skip
        v_splats = np.empty((len(v_motion), SPLAT_WIDTH), np.float32)
        gather_gradient(bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot, v_pairs, v_splats)
        _pull(self.jacobian, self._rows, _COLUMNS, v_splats, v_motion)


def _arrays(gaussians: Gaussians) -> tuple[np.ndarray, ...]:
    g = gaussians
    return tuple(
        np.ascontiguousarray(a.cpu().numpy(), np.float32)
        for a in (g.means, g.quats, g.scales, g.opacities, g.sh)
    )


def _turned_by_axes(quats: np.ndarray) -> np.ndarray:
    """[N, 3, 4]: change of each quaternion (wxyz) for a small rotation about each world axis."""
    w, x, y, z = quats.T
    turned = np.stack([[-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
    return 0.5 * turned.transpose(2, 0, 1)


def rest_view(gaussians: Gaussians, camera: FixedCamera, size: tuple[int, int]) -> RestView:
    """A camera (size: width, height) at rest, with its Jacobian."""
    width, height = size
    means, quats, scales, opacities, sh = _arrays(gaussians)
    degree = gaussians.sh_degree
    packed = pack_camera(camera.viewmat, camera.K, NEAR, FAR, EPS2D, ALPHA_MIN_LINEAR)
    splats = empty_splats(len(means))
    project_forward(means, quats, scales, opacities, sh, degree, False, packed, width, height, splats)
    bins = bin_splats(splats, width, height)
    image, transmittance = (
        np.empty((height, width, FEATURES), np.float32),
        np.empty((height, width), np.float32),
    )
    blend_forward(
        splats, bins.tile_start, bins.pair_gaussian, width, height, image, transmittance, ALPHA_MIN_LINEAR
    )
    visible = bins.order[: bins.n_visible]
    turned = _turned_by_axes(quats)[visible]
    jacobian = np.empty((len(visible), len(_COLUMNS), DOF), np.float32)
    for c, column in enumerate(_COLUMNS):
        v_splats = np.zeros_like(splats)
        v_splats[:, column] = 1
        grads = [np.zeros_like(a) for a in (means, quats, scales, opacities, sh)]
        project_backward(
            means, quats, scales, sh, degree, False, packed, width, height, splats, v_splats,
            *grads, np.zeros((0, 12), np.float32), False,
        )  # fmt: skip
        jacobian[:, c, :3] = grads[0][visible]
        jacobian[:, c, 3:] = np.einsum("nkq,nq->nk", turned, grads[1][visible])
    return RestView(splats, bins, image, transmittance, jacobian)
