"""The rendering Jacobian of one view at rest: JVP, VJP and Gauss-Newton product, several right-hand sides at once.

Per Gaussian an 8 × 6 block takes displacement and rotation to its splat (mean, conic, colour); the linearised blending
kernels take splats to pixels. It is the exact derivative of the rendered picture; no finite differences. To first order
it also gives how far things move in pixels, their optical flow, and how well depth is determined.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from tg4mm.capture.tracking.template import slope
from tg4mm.core.memory import Buffers, mapped_zeros, release
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.jacobian.packed import (
    COLUMNS,
    DOF,
    jvp_rows,
    mean_rows,
    mean_rows_as_colours,
    pack,
    splat_jacobian,
    unpack,
    vjp_rows,
)
from tg4mm.fit.rasterize.kernels.binning import Bins, bin_splats, seen
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MIN, FEATURES
from tg4mm.fit.rasterize.kernels.linearised import (
    BlendedView,
    blend_cotangents,
    blend_normal,
    blend_tangents,
    most_blocks,
)
from tg4mm.fit.rasterize.kernels.project import empty_splats, pack_camera, project_forward
from tg4mm.fit.space.view import FAR, WHITE, near_plane

# Rendering drops alphas below 1/255, which cuts the rim off every Gaussian. The cut moves with the Gaussian, and that
# step is not in the derivative inside it: faint Gaussians would get too small a Jacobian (by 1/255 over their opacity).
# A much lower threshold makes the error negligible.
ALPHA_MIN_LINEAR = ALPHA_MIN / 30
VIEW_BYTES = 1 << 30  # of all views that are held at once: more lie in temporary files
_OF_VIEW = "splats", "image", "transmittance", "packed"
_OF_BINS = "order", "tile_start", "gaussian_start", "pair_gaussian", "pair_slot", "reached"
PERCENT = 99.0  # of the visible Gaussians: outliers of a fit must not decide
_CAMERAS = 8  # views looked at, spread evenly
_COLOUR = COLUMNS - 3  # first column of a splat's colour


class PosedView(Protocol):
    """A camera as far as the Jacobian needs it (OpenCV convention)."""

    @property
    def viewmat(self) -> np.ndarray:
        """Return [4, 4] float32, world to camera."""

    @property
    def K(self) -> np.ndarray:
        """Return [3, 3] float32, pixels."""

    @property
    def low_pass(self) -> float:
        """Square pixels added to a projected Gaussian's variance."""


@dataclass(frozen=True)
class ViewJacobian:
    """One view's picture of the Gaussians at rest and its Jacobian."""

    splats: np.ndarray  # [N, SPLAT_WIDTH]
    bins: Bins
    image: np.ndarray  # [H, W, FEATURES]
    transmittance: np.ndarray  # [H, W]
    most: tuple[int, int]  # largest numbers of blocks and pairs of a tile, for `blend_normal`
    packed: np.ndarray  # float32: the 8 × 6 blocks as `pack` stores them, in the order of bins.order

    @property
    def over_white(self) -> np.ndarray:
        """Return [H, W, 3]: the picture at rest."""
        return self.image[..., :3] + self.transmittance[..., None]

    @property
    def jacobian(self) -> np.ndarray:
        """Return [n_visible, 8, DOF] float32, in the order of bins.order."""
        return unpack(self.packed)

    @property
    def _blended(self) -> BlendedView:
        return BlendedView(self.splats, self.bins, self.most, WHITE, ALPHA_MIN_LINEAR)

    @property
    def _rows(self) -> np.ndarray:
        return self.bins.order[: self.bins.n_visible]

    def jvp(self, motions: np.ndarray, buffers: Buffers | None = None) -> np.ndarray:
        """J m: R motions [R, N, DOF] float32 -> R changes of the picture over white [R, H, W, 3].

        With `buffers` the result is theirs: valid until the next call with the same ones.
        """
        n_motions, buffers = len(motions), buffers or Buffers()
        d_splats = buffers.take("d_splats", (motions.shape[1], n_motions, COLUMNS))
        jvp_rows(self.packed, self._rows, motions, d_splats)
        d_images = buffers.take("d_images", (n_motions, *self.transmittance.shape, 3))
        blend_tangents(self._blended, d_splats, d_images)
        return d_images

    def vjp(self, pictures: np.ndarray, v_motions: np.ndarray, buffers: Buffers | None = None) -> None:
        """Add Jᵀ p of R pictures [R, H, W, 3] to `v_motions` [R, N, DOF]."""
        bins, n_motions, buffers = self.bins, len(pictures), buffers or Buffers()
        v_pairs = buffers.take("v_pairs", (len(bins.pair_gaussian), n_motions, COLUMNS))
        blend_cotangents(self._blended, np.ascontiguousarray(pictures), v_pairs)
        self._gather(v_pairs, v_motions)

    def gauss_newton_product(
        self,
        motions: np.ndarray,
        weights: np.ndarray | None,
        v_motions: np.ndarray,
        buffers: Buffers | None = None,
    ) -> None:
        """Add Jᵀ W J m to `v_motions`, both [R, N, DOF], in one pass; W are weights of pixels [H, W], None: 1."""
        bins, n_motions, buffers = self.bins, len(motions), buffers or Buffers()
        d_splats = buffers.take("d_splats", (motions.shape[1], n_motions, COLUMNS))
        jvp_rows(self.packed, self._rows, motions, d_splats)
        v_pairs = buffers.take("v_pairs", (len(bins.pair_gaussian), n_motions, COLUMNS))
        pixels = np.ones_like(self.transmittance) if weights is None else weights
        blend_normal(self._blended, d_splats, pixels, v_pairs)
        self._gather(v_pairs, v_motions)

    def stored(self) -> "ViewJacobian":
        """The same with its arrays in a temporary file (`mapped_zeros`): `release` lets go of what a call has read."""
        bins = copy(self.bins)
        for name in _OF_BINS:
            setattr(bins, name, _stored(getattr(bins, name)))
        splats, image, transmittance, packed = (_stored(getattr(self, name)) for name in _OF_VIEW)
        return ViewJacobian(splats, bins, image, transmittance, self.most, packed)

    def release(self) -> None:
        """Let go of the memory that holds what is stored in a file."""
        for array in self._arrays:
            release(array)

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in self._arrays)

    @property
    def _arrays(self) -> list[np.ndarray]:
        arrays = [getattr(self, name) for name in _OF_VIEW]
        return arrays + [getattr(self.bins, name) for name in _OF_BINS]

    def _gather(self, v_pairs: np.ndarray, v_motions: np.ndarray) -> None:
        """Add the cotangents of tile–Gaussian pairs [P, R, 8] to `v_motions` [R, N, DOF]."""
        vjp_rows(self.packed, self._rows, self.bins.gaussian_start, self.bins.pair_slot, v_pairs, v_motions)


def _stored(array: np.ndarray) -> np.ndarray:
    out = mapped_zeros(array.shape, array.dtype, in_memory=0) if array.size else array
    out[...] = array
    release(out)
    return out


def _arrays(gaussians: Gaussians) -> tuple[np.ndarray, ...]:
    g = gaussians
    return tuple(
        np.ascontiguousarray(a.cpu().numpy(), np.float32)
        for a in (g.means, g.quats, g.scales, g.opacities, g.sh)
    )


def view_jacobian(gaussians: Gaussians, camera: PosedView, size: tuple[int, int]) -> ViewJacobian:
    """The Jacobian of the Gaussians' picture from `camera`, of size (width, height)."""
    width, height = size
    means, quats, scales, opacities, sh = _arrays(gaussians)
    degree = gaussians.sh_degree
    near = near_plane(means, camera.viewmat)
    packed_camera = pack_camera(camera.viewmat, camera.K, near, FAR, camera.low_pass, ALPHA_MIN_LINEAR)
    splats = empty_splats(len(means))
    project_forward(means, quats, scales, opacities, sh, degree, packed_camera, width, height, splats)
    bins = bin_splats(splats, width, height)
    image = np.empty((height, width, FEATURES), np.float32)
    transmittance = np.empty((height, width), np.float32)
    blend_forward(
        splats, bins.tile_start, bins.pair_gaussian, width, height, image, transmittance, ALPHA_MIN_LINEAR,
        bins.reached,
    )  # fmt: skip
    bins = seen(bins)  # drop hidden pairs: every iteration would visit them
    most = most_blocks(bins.tile_start, bins.reached)
    jacobian = splat_jacobian(means, quats, scales, sh, degree, packed_camera, size, splats)
    return ViewJacobian(
        splats, bins, image, transmittance, most, pack(jacobian[bins.order[: bins.n_visible]])
    )


def colour_jacobian(view: ViewJacobian, active: np.ndarray) -> ViewJacobian:
    """The view with the Jacobian by colour in place of displacement (the first three of DOF; the others give 0).

    active [n_visible, 3] bool, in the order of bins.order: channels whose derivative is not 0 (not clamped).
    """
    jacobian = np.zeros((len(active), COLUMNS, DOF), np.float32)
    for c in range(3):
        jacobian[:, _COLOUR + c, c] = active[:, c]
    return replace(view, packed=pack(jacobian))


def without_colour(view: ViewJacobian) -> ViewJacobian:
    """The view with colours that no motion changes, as if they were the same from all sides."""
    jacobian = view.jacobian
    jacobian[:, _COLOUR:] = 0
    return replace(view, packed=pack(jacobian))


def blend_sum(view: ViewJacobian, picture: np.ndarray) -> np.ndarray:
    """Return [N, 3] float32: a picture [H, W, 3] summed over pixels by each Gaussian's blending weights."""
    out = np.zeros((1, len(view.splats), DOF), np.float32)
    colour_jacobian(view, np.ones((view.bins.n_visible, 3), bool)).vjp(picture[None], out)
    return out[0, :, :3]


def pixels_moved(views: Sequence[ViewJacobian], shifts: np.ndarray) -> np.ndarray:
    """Return [S]: the 99th percentile of image motion over visible Gaussians in up to eight views; 0 if none is.

    S shifts [S, N, 3] in scene units, projected to first order.
    """
    some = np.unique(np.linspace(0, len(views) - 1, _CAMERAS).round().astype(int))
    lengths = np.concatenate([_lengths(views[k], shifts) for k in some], 1)
    if not lengths.size:
        return np.zeros(len(shifts))
    return np.asarray(np.percentile(lengths, PERCENT, axis=1))


def _lengths(view: ViewJacobian, shifts: np.ndarray) -> np.ndarray:
    """Return [S, n] pixels."""
    right, down = mean_rows(view.packed)
    visible = shifts[:, view.bins.order[: view.bins.n_visible]]
    return np.asarray(np.hypot(*(np.einsum("nd,snd->sn", row, visible) for row in (right, down))))


def optical_flow(view: ViewJacobian, motions: np.ndarray, buffers: Buffers) -> np.ndarray:
    """Return [R, H, W, 3] of motions [R, N, DOF]: right and down in pixels, then 0; valid until `buffers` is reused.

    Each pixel sums the flow of its Gaussians' means by blending weight; the background's flow is 0.
    """
    return replace(view, packed=mean_rows_as_colours(view.packed)).jvp(motions, buffers)


def false_changes(
    view: ViewJacobian, mean: np.ndarray, motions: np.ndarray, is_flat: bool = True
) -> np.ndarray:
    """Return [R, H, W, 3]: of the change by motions [R, N, DOF] what the scene at rest has and `mean` [H, W, 3] lacks.

    It corrects the answer of one fixed camera, by slopes exact for fine texture (`is_flat`). `measure` takes it into
    the ± in 3D, whose calibration has central differences.
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
