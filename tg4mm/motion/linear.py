"""How images answer to small motions: the Jacobian of rendering at rest, forward and transposed.

Per view and Gaussian an 8 × 6 matrix takes displacement and rotation to the projected splat (mean, conic,
colour); the blending kernels do the rest. Nothing is approximated but the motion's smallness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import float32, njit, prange

from tg4mm.gaussians import Gaussians
from tg4mm.motion.video import FixedCamera
from tg4mm.rasterize.buffers import Buffers, take
from tg4mm.rasterize.kernels.binning import Bins, bin_splats, gather_gradient
from tg4mm.rasterize.kernels.blend import blend_forward
from tg4mm.rasterize.kernels.layout import ALPHA_MIN, FEATURES
from tg4mm.rasterize.kernels.linearised import COLUMNS, blend_cotangents, blend_tangents
from tg4mm.rasterize.kernels.project import empty_splats, pack_camera, project_forward
from tg4mm.rasterize.kernels.project_backward import project_backward
from tg4mm.space.view import EPS2D, FAR, NEAR, WHITE

# A picture's cut-off at 1/255 takes the rim off every Gaussian. The rim moves along: as a step, of which a derivative
# inside the rim knows nothing. That would make faint Gaussians answer too weakly (by 1/255 over their opacity), so the
# Jacobian is taken with hardly any cut-off.
ALPHA_MIN_LINEAR = ALPHA_MIN / 30
DOF = 6  # displacement (scene units) and rotation vector (radians, world axes)


@njit(parallel=True, fastmath=True, cache=True)
def _push(jacobian, rows, motions, d_splats):
    """motions [R, N, DOF] -> d_splats [N, R, 8], where seen."""
    for k in prange(len(rows)):
        i = rows[k]
        for r in range(len(motions)):
            for c in range(jacobian.shape[1]):
                total = float32(0.0)
                for d in range(jacobian.shape[2]):
                    total += jacobian[k, c, d] * motions[r, i, d]
                d_splats[i, r, c] = total


@njit(parallel=True, fastmath=True, cache=True)
def _pull(jacobian, rows, v_splats, v_motions):
    """Adds to v_motions [R, N, DOF] what v_splats [N, R, 8] say."""
    for k in prange(len(rows)):
        i = rows[k]
        for r in range(len(v_motions)):
            for d in range(jacobian.shape[2]):
                total = float32(0.0)
                for c in range(jacobian.shape[1]):
                    total += jacobian[k, c, d] * v_splats[i, r, c]
                v_motions[r, i, d] += total


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
        return self.push_all(motion[None])[0]

    def pull(self, picture: np.ndarray, v_motion: np.ndarray) -> None:
        """The transpose: adds to `v_motion` [N, DOF] what a picture [H, W, 3] says."""
        self.pull_all(picture[None], v_motion[None])

    def push_all(self, motions: np.ndarray, buffers: Buffers | None = None) -> np.ndarray:
        """R motions [R, N, DOF] float32 -> R changes of the picture over white [R, H, W, 3], in one pass.

        With `buffers` they lie there, until the next call with the same ones.
        """
        bins, n_changes = self.bins, len(motions)
        d_splats = take(buffers, "d_splats", (motions.shape[1], n_changes, len(COLUMNS)))
        _push(self.jacobian, self._rows, motions, d_splats)
        d_images = take(buffers, "d_images", (n_changes, *self.transmittance.shape, 3))
        blend_tangents(
            self.splats, d_splats, bins.tile_start, bins.pair_gaussian, WHITE, d_images, ALPHA_MIN_LINEAR
        )
        return d_images

    def pull_all(self, pictures: np.ndarray, v_motions: np.ndarray, buffers: Buffers | None = None) -> None:
        """The transpose: adds to `v_motions` [R, N, DOF] what R pictures [R, H, W, 3] say."""
        bins, n_changes = self.bins, len(pictures)
        v_pairs = take(buffers, "v_pairs", (len(bins.pair_gaussian), n_changes, len(COLUMNS)))
        blend_cotangents(
            self.splats, bins.tile_start, bins.pair_gaussian, WHITE, self.image, self.transmittance,
            np.ascontiguousarray(pictures), v_pairs, ALPHA_MIN_LINEAR,
        )  # fmt: skip
        v_splats = take(buffers, "d_splats", (v_motions.shape[1], n_changes, len(COLUMNS)))
        flat = n_changes * len(COLUMNS)
        gather_gradient(
            bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot,
            v_pairs.reshape(-1, flat), v_splats.reshape(-1, flat),
        )  # fmt: skip
        _pull(self.jacobian, self._rows, v_splats, v_motions)


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
    jacobian = np.empty((len(visible), len(COLUMNS), DOF), np.float32)
    for c, column in enumerate(COLUMNS):
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
