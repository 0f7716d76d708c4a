"""Scenes of random Gaussians, and every kernel of the rasteriser as a call on its own."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from tg4mm.fit.rasterize.buffers import Buffers
from tg4mm.fit.rasterize.kernels import binning
from tg4mm.fit.rasterize.kernels import project as projection
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.blend_backward import blend_backward
from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project_backward import project_backward
from tg4mm.fit.space.view import EPS2D, FAR, NEAR

DISTANCE = 3.0  # scene units from the camera to the ball's centre
PIXELS = 2.0  # standard deviation of a Gaussian


def scene(n: int, size: int, seed: int = 0) -> tuple[list[Tensor], Tensor, Tensor]:
    """Parameters (means … sh of degree 3) of n Gaussians in the unit ball, viewmat [4, 4] and K [3, 3]."""
    rng = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(torch.randn(n, 3, generator=rng), dim=-1)
    means = direction * torch.rand(n, 1, generator=rng) ** (1 / 3)
    focal = 1.2 * size
    scales = PIXELS * DISTANCE / focal * torch.exp(0.6 * torch.randn(n, 3, generator=rng).clamp(-2, 2))
    parameters = [
        means,
        torch.randn(n, 4, generator=rng),
        scales,
        torch.rand(n, generator=rng) * 0.9 + 0.05,
        torch.randn(n, 16, 3, generator=rng) * 0.2,
    ]
    viewmat = torch.eye(4)
    viewmat[2, 3] = DISTANCE
    return parameters, viewmat, torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])


class Kernels:
    """Every kernel as a call on its own, for one view of given Gaussians."""

    def __init__(
        self, arrays: list[np.ndarray], viewmat: np.ndarray, K: np.ndarray, size: tuple[int, int]
    ) -> None:
        width, height = size
        camera = projection.pack_camera(viewmat, K, NEAR, FAR, EPS2D)
        splats = projection.empty_splats(len(arrays[0]))
        project = (*arrays, 3, False, camera, width, height, splats)
        projection.project_forward(*project)
        buffers = Buffers()
        bins = binning.bin_splats(splats, width, height)
        self.lists = (splats, bins.tile_start, bins.pair_gaussian, width, height)
        rng = np.random.default_rng(0)
        image, v_image = np.empty((2, height, width, FEATURES), np.float32)
        transmittance, v_transmittance = np.empty((2, height, width), np.float32)
        v_image[:], v_transmittance[:] = (
            rng.normal(size=v_image.shape),
            rng.normal(size=v_transmittance.shape),
        )
        pair_sums = np.empty((len(bins.pair_gaussian), SPLAT_WIDTH), np.float32)
        v_splats = projection.empty_splats(len(splats))
        v_splats[:] = 0
        pictures = (image, transmittance, v_image, v_transmittance, pair_sums)
        slots = (bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot)
        gather = (*slots, pair_sums, v_splats)
        back = (*arrays[:3], arrays[4], 3, False, camera, width, height, splats, v_splats, True)
        gradients = (*(np.zeros_like(a) for a in arrays), np.zeros((0, 12), np.float32), False)
        self.n_gaussians, self.n_pairs = len(arrays[0]), len(bins.pair_gaussian)
        self.reached = reached = bins.reached  # written by `blend`
        self.calls: dict[str, Callable[[], object]] = {
            "project": lambda: projection.project_forward(*project),
            "bin": lambda: binning.bin_splats(splats, width, height, buffers),
            "blend": lambda: blend_forward(*self.lists, image, transmittance, reached=reached),
            "blend, picture alone": lambda: blend_forward(*self.lists, image, transmittance),
            "blend backward": lambda: blend_backward(*self.lists, *pictures, reached=reached),
            "gather": lambda: binning.gather_sums(*gather),
            "project backward": lambda: project_backward(*back, *gradients),
        }
