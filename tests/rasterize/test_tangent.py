"""Forward mode: `blend_tangent` against the backward kernels, its adjoint, and differences of images."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.rasterize.oracle import make_scene, render
from tg4mm.rasterize.kernels.binning import bin_splats, gather_gradient
from tg4mm.rasterize.kernels.blend import blend_backward, blend_forward, blend_tangent
from tg4mm.rasterize.kernels.layout import (
    CA,
    CC,
    FEAT,
    FEATURES,
    L22,
    MX,
    OP,
    POWER,
    R11,
    SPLAT_WIDTH,
    SQUARES,
)

WIDTH, HEIGHT = 50, 37
SCENES = {
    "ordinary": make_scene(0),
    "light spent": make_scene(19, n=250, spread=0.3, scale=(0.1, 0.4), opacity=(0.3, 0.95)),
    "nearly opaque": make_scene(6, opacity=(0.9995, 1.0), scale=(0.05, 0.5)),
}


def projected(name: str) -> np.ndarray:
    """Splats [N, SPLAT_WIDTH] of the scene's first camera."""
    scene = SCENES[name]
    tensors = [t.detach() for t in scene.tensors(torch.float32)]
    return render(tensors, scene, 3)[2]["projected"][0].splats


def forward(splats: np.ndarray, bins_of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Image [H, W, FEATURES] and transmittance [H, W] with the tile lists of `bins_of`."""
    bins = bin_splats(bins_of, WIDTH, HEIGHT)
    image = np.empty((HEIGHT, WIDTH, FEATURES), np.float32)
    transmittance = np.empty((HEIGHT, WIDTH), np.float32)
    blend_forward(splats, bins.tile_start, bins.pair_gaussian, WIDTH, HEIGHT, image, transmittance)
    return image, transmittance


def tangent(splats: np.ndarray, d_splats: np.ndarray) -> np.ndarray:
    bins = bin_splats(splats, WIDTH, HEIGHT)
    d_image = np.empty((HEIGHT, WIDTH, 4), np.float32)
    blend_tangent(splats, d_splats, bins.tile_start, bins.pair_gaussian, WIDTH, HEIGHT, d_image)
    return d_image


def with_squares(splats: np.ndarray) -> np.ndarray:
    """The splats with the columns that follow from the conic made to follow."""
    seen = splats[:, POWER] > 0
    a, b, c = splats[seen, CA : CC + 1].T.astype(np.float64)
    splats[seen, R11] = 1 / np.sqrt(SQUARES * a)
    splats[seen, L22] = np.sqrt(SQUARES * (c - b * b / a))
    return splats


def direction(n: int, seed: int) -> np.ndarray:
    """A change of means, conics and three features [N, FEAT + 3]; the opacity is held."""
    d = np.random.default_rng(seed).normal(size=(n, FEAT + 3)).astype(np.float32)
    d[:, OP] = 0
    return d


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("columns", [slice(MX, MX + 2), slice(MX + 2, CC + 1), slice(FEAT, FEAT + 3)])
def test_it_is_the_adjoint_of_the_backward_pass(name: str, columns: slice) -> None:
    """⟨v, J d⟩ = ⟨Jᵀ v, d⟩ for random v and d, to the rounding of the terms that are summed."""
    splats = projected(name)
    image, transmittance = forward(splats, splats)
    rng = np.random.default_rng(1)
    v_image = rng.normal(size=image.shape).astype(np.float32)
    v_image[..., 3:] = 0
    v_transmittance = rng.normal(size=transmittance.shape).astype(np.float32)
    bins = bin_splats(splats, WIDTH, HEIGHT)
    v_pairs = np.empty((len(bins.pair_gaussian), FEAT + FEATURES), np.float32)
    blend_backward(
        splats, bins.tile_start, bins.pair_gaussian, WIDTH, HEIGHT,
        image, transmittance, v_image, v_transmittance, v_pairs,
    )  # fmt: skip
    v_splats = np.zeros_like(splats)
    gather_gradient(bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot, v_pairs, v_splats)
    d = np.zeros((len(splats), FEAT + 3), np.float32)
    d[:, columns] = direction(len(splats), 2)[:, columns]
    d_image = tangent(splats, d)
    terms = v_splats[:, : FEAT + 3].astype(np.float64) * d
    weights = np.concatenate([v_image[..., :3], v_transmittance[..., None]], -1)
    forward_mode = (d_image.astype(np.float64) * weights).sum()
    assert np.abs(terms).sum() > 1
    assert abs(forward_mode - terms.sum()) < 2e-5 * np.abs(terms).sum()


@pytest.mark.parametrize("name", ["ordinary", "light spent"])
def test_it_is_the_derivative_of_the_image(name: str) -> None:
    """Central differences along a small step; the few pixels that cross a threshold are allowed for."""
    splats = projected(name)
    d = direction(len(splats), 3)
    d[:, MX + 2 : CC + 1] *= 0.01 * splats[:, MX + 2 : CC + 1]
    d[:, MX : MX + 2] *= 0.1
    step, images = 2e-2, []
    for sign in (1, -1):
        moved = with_squares(splats + sign * step * np.pad(d, ((0, 0), (0, SPLAT_WIDTH - FEAT - 3))))
        image, transmittance = forward(moved, splats)
        images.append(np.concatenate([image[..., :3], transmittance[..., None]], -1).astype(np.float64))
    differences = (images[0] - images[1]) / (2 * step)
    actual = tangent(splats, d)
    assert np.abs(actual).max() > 0.1
    error = np.abs(actual - differences) / np.abs(actual).max()
    assert np.median(error) < 1e-4
    assert (error > 5e-3).mean() < 0.02
