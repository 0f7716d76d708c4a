"""How images answer to small motions: the Jacobian of rendering at rest, forward and transposed.

Per view and Gaussian an 8 × 6 matrix takes displacement and rotation to the projected splat (mean, conic,
colour); the blending kernels do the rest. Nothing is approximated but the motion's smallness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.jacobian.packed import packed, pull, push, unpacked
from tg4mm.motion.jacobian.projection import splat_jacobian
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.rasterize.buffers import Buffers, take
from tg4mm.rasterize.kernels.binning import Bins, bin_splats, seen
from tg4mm.rasterize.kernels.blend import blend_forward
from tg4mm.rasterize.kernels.layout import ALPHA_MIN, FEATURES
from tg4mm.rasterize.kernels.linearised import COLUMNS, blend_cotangents, blend_tangents
from tg4mm.rasterize.kernels.normal import blend_normal, most_blocks
from tg4mm.rasterize.kernels.project import empty_splats, pack_camera, project_forward
from tg4mm.space.view import EPS2D, FAR, NEAR, WHITE

# A picture's cut-off at 1/255 takes the rim off every Gaussian. The rim moves along: as a step, of which a derivative
# inside the rim knows nothing. That would make faint Gaussians answer too weakly (by 1/255 over their opacity), so the
# Jacobian is taken with hardly any cut-off.
ALPHA_MIN_LINEAR = ALPHA_MIN / 30


@dataclass(frozen=True)
class RestView:
    """One camera's picture of the Gaussians at rest and its Jacobian."""

    splats: np.ndarray  # [N, SPLAT_WIDTH]
    bins: Bins
    image: np.ndarray  # [H, W, FEATURES]
    transmittance: np.ndarray  # [H, W]
    most: tuple[int, int]  # blocks and pairs of a tile, for `blend_normal`
    answers: np.ndarray  # float32: `packed` Jacobians, in the order of bins.order

    @property
    def jacobian(self) -> np.ndarray:
        """[n_visible, 8, DOF] float32, in the order of bins.order."""
        return unpacked(self.answers)

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
        push(self.answers, self._rows, motions, d_splats)
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
        self._gather(v_pairs, v_motions)

    def normal_all(
        self,
        motions: np.ndarray,
        weights: np.ndarray | None,
        v_motions: np.ndarray,
        buffers: Buffers | None = None,
    ) -> None:
        """`push_all`, times the weights of pixels [H, W] or 1, and `pull_all`, in one pass."""
        bins, n_changes = self.bins, len(motions)
        d_splats = take(buffers, "d_splats", (motions.shape[1], n_changes, len(COLUMNS)))
        push(self.answers, self._rows, motions, d_splats)
        v_pairs = take(buffers, "v_pairs", (len(bins.pair_gaussian), n_changes, len(COLUMNS)))
        pixels = np.ones_like(self.transmittance) if weights is None else weights
        blend_normal(
            self.splats, d_splats, bins.tile_start, bins.pair_gaussian, bins.reached, self.most, WHITE, pixels,
            v_pairs, ALPHA_MIN_LINEAR,
        )  # fmt: skip
        self._gather(v_pairs, v_motions)

    def _gather(self, v_pairs: np.ndarray, v_motions: np.ndarray) -> None:
        """Adds to `v_motions` [R, N, DOF] what pairs [P, R, 8] say."""
        pull(self.answers, self._rows, self.bins.gaussian_start, self.bins.pair_slot, v_pairs, v_motions)


def _arrays(gaussians: Gaussians) -> tuple[np.ndarray, ...]:
    g = gaussians
    return tuple(
        np.ascontiguousarray(a.cpu().numpy(), np.float32)
        for a in (g.means, g.quats, g.scales, g.opacities, g.sh)
    )


def rest_view(gaussians: Gaussians, camera: FixedCamera, size: tuple[int, int]) -> RestView:
    """A camera (size: width, height) at rest, with its Jacobian."""
    width, height = size
    means, quats, scales, opacities, sh = _arrays(gaussians)
    degree = gaussians.sh_degree
    packed_camera = pack_camera(camera.viewmat, camera.K, NEAR, FAR, EPS2D, ALPHA_MIN_LINEAR)
    splats = empty_splats(len(means))
    project_forward(means, quats, scales, opacities, sh, degree, False, packed_camera, width, height, splats)
    bins = bin_splats(splats, width, height)
    image, transmittance = (
        np.empty((height, width, FEATURES), np.float32),
        np.empty((height, width), np.float32),
    )
    blend_forward(
        splats, bins.tile_start, bins.pair_gaussian, width, height, image, transmittance, ALPHA_MIN_LINEAR,
        bins.reached,
    )  # fmt: skip
    bins = seen(bins)  # the others would be asked in every iteration
    most = most_blocks(bins.tile_start, bins.reached)
    jacobian = splat_jacobian(means, quats, scales, sh, degree, packed_camera, size, splats)
    answers = packed(jacobian[bins.order[: bins.n_visible]])
    return RestView(splats, bins, image, transmittance, most, answers)
