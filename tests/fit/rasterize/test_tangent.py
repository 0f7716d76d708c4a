"""Blending linearised: `blend_tangents` against the backward kernels, differences of images, and its transpose."""

import numpy as np
import pytest
import torch

from tests.fit.rasterize.oracle import make_scene, render
from tg4mm.fit.rasterize.kernels.binning import bin_splats
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.layout import (
    ALPHA_MIN,
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
from tg4mm.fit.rasterize.kernels.linearised import COLUMNS, blend_cotangents, blend_tangents

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


def tangents(splats: np.ndarray, changes: list[np.ndarray], white: float) -> np.ndarray:
    """Changes [R, H, W, 3] of the picture over `white` for changes [N, FEAT + 3] of the splats."""
    bins = bin_splats(splats, WIDTH, HEIGHT)
    d_images = np.full((len(changes), HEIGHT, WIDTH, 3), np.nan, np.float32)
    d_splats = np.stack([d[:, COLUMNS] for d in changes], 1)
    blend_tangents(splats, d_splats, bins.tile_start, bins.pair_gaussian, white, d_images, ALPHA_MIN)
    return d_images


def tangent(splats: np.ndarray, d_splats: np.ndarray) -> np.ndarray:
    """Change of three features and of the transmittance [H, W, 4]."""
    over_black, over_white = (tangents(splats, [d_splats], white)[0] for white in (0.0, 1.0))
    return np.concatenate([over_black, (over_white - over_black)[..., :1]], -1)


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
@pytest.mark.parametrize("white", [0.0, 1.0, 0.3])
def test_the_transpose_is_the_transpose(name: str, white: float) -> None:
    """⟨v, J d⟩ = ⟨Jᵀ v, d⟩ for three changes at once, column by column of the splats."""
    splats = projected(name)
    image, transmittance = forward(splats, splats)
    bins = bin_splats(splats, WIDTH, HEIGHT)
    v_images = np.random.default_rng(4).normal(size=(3, HEIGHT, WIDTH, 3)).astype(np.float32)
    v_pairs = np.full((len(bins.pair_gaussian), 3, len(COLUMNS)), np.nan, np.float32)
    lists = (bins.tile_start, bins.pair_gaussian)
    blend_cotangents(splats, *lists, white, image, transmittance, v_images, v_pairs, ALPHA_MIN)
    v_splats = np.zeros((len(splats), 3, len(COLUMNS)))
    np.add.at(v_splats, bins.pair_gaussian, v_pairs)
    for columns in (slice(MX, MX + 2), slice(MX + 2, CC + 1), slice(FEAT, FEAT + 3)):
        changes = [np.zeros((len(splats), FEAT + 3), np.float32) for _ in range(3)]
        for seed, change in enumerate(changes):
            change[:, columns] = direction(len(splats), seed)[:, columns]
        d_images = tangents(splats, changes, white).astype(np.float64)
        for r, change in enumerate(changes):
            terms = v_splats[:, r] * change[:, COLUMNS]
            assert np.abs(terms).sum() > 1
            assert abs((d_images[r] * v_images[r]).sum() - terms.sum()) < 2e-5 * np.abs(terms).sum()


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
