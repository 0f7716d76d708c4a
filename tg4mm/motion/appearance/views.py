"""The Jacobian of a picture by changes of colour: blending weights, times spherical harmonics of the directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.motion.few_view_posterior import viewing_rays
from tg4mm.motion.jacobian.colour import colour_jacobian
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.jacobian.view import PosedView, ViewJacobian
from tg4mm.rasterize.buffers import Buffers
from tg4mm.rasterize.kernels.compiled import kernel
from tg4mm.rasterize.kernels.layout import FEAT

HARMONIC = 0.28209479177387814  # the first: times its coefficient it is a colour
_TILT = np.float32(np.sqrt(3.0))  # of degree 1 beside it


@dataclass(frozen=True)
class AppearanceView:
    """One camera's picture as a linear function of changes of colour x [R, N, K, 3].

    Of K = 1 or 4 coefficients the first is the colour's mean over all directions, the others are its tilt, in units in
    which all have the same mean square over directions.
    """

    view: ViewJacobian  # its Jacobian takes "displacements" for colours
    harmonics: np.ndarray  # [N, K] float32

    def jvp(self, x: np.ndarray, buffers: Buffers) -> np.ndarray:
        """Changes of the picture [R, H, W, 3], until the next call with the same `buffers`."""
        return self.view.jvp(self._colours(x, buffers), buffers)

    def vjp(self, pictures: np.ndarray, out: np.ndarray, buffers: Buffers) -> None:
        """The transpose: adds to `out` [R, N, K, 3] the product with pictures [R, H, W, 3]."""
        v = self._nothing(out, buffers, "v_colours")
        self.view.vjp(pictures, v, buffers)
        _gather(self.harmonics, v, out)

    def gauss_newton_product(
        self, x: np.ndarray, weights: np.ndarray | None, out: np.ndarray, buffers: Buffers
    ) -> None:
        """`jvp`, times the weights of pixels [H, W] or 1, and `vjp`, in one pass."""
        v = self._nothing(out, buffers, "v_colours")
        self.view.gauss_newton_product(self._colours(x, buffers), weights, v, buffers)
        _gather(self.harmonics, v, out)

    def _colours(self, x: np.ndarray, buffers: Buffers) -> np.ndarray:
        colours = self._nothing(x, buffers, "colours")
        _spread(self.harmonics, x, colours)
        return colours

    @staticmethod
    def _nothing(x: np.ndarray, buffers: Buffers, name: str) -> np.ndarray:
        room = buffers.take(name, (x.shape[0], x.shape[1], DOF))
        room[:] = 0
        return room


def appearance_views(
    views: Sequence[ViewJacobian], cameras: Sequence[PosedView], means: np.ndarray, tilts: bool
) -> list[AppearanceView]:
    """Of Gaussians at `means` [N, 3]; with `tilts` K is 4, else 1."""
    out = []
    for view, camera in zip(views, cameras, strict=True):
        harmonics = np.ones((len(means), 4 if tilts else 1), np.float32)
        if tilts:
            x, y, z = viewing_rays(camera, means).T
            harmonics[:, 1:] = _TILT * np.stack([-y, z, -x], 1)
        colours = view.splats[view.bins.order[: view.bins.n_visible], FEAT : FEAT + 3]
        out.append(
            AppearanceView(colour_jacobian(view, colours > 0), harmonics)
        )  # what is clamped at 0 does not change
    return out


@kernel()
def _spread(harmonics, x, colours):
    """colours[r, n, :3] = Σ_k harmonics[n, k] x[r, n, k]."""
    for r in range(x.shape[0]):
        for n in range(x.shape[1]):
            for k in range(x.shape[2]):
                for c in range(3):
                    colours[r, n, c] += harmonics[n, k] * x[r, n, k, c]


@kernel()
def _gather(harmonics, v_colours, out):
    """The transpose of `_spread`, added to `out`."""
    for r in range(out.shape[0]):
        for n in range(out.shape[1]):
            for k in range(out.shape[2]):
                for c in range(3):
                    out[r, n, k, c] += harmonics[n, k] * v_colours[r, n, c]
