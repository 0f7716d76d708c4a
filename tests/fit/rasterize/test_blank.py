"""Tiles that no Gaussian reaches are written by those who work on the others, a row at a time."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.fit.rasterize.oracle import make_scene, render
from tg4mm.fit.rasterize.kernels import blend
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MIN, FEATURES, TILE
from tg4mm.fit.rasterize.kernels.tiles import TABLE


@pytest.mark.parametrize("workers", [1, 2, 7])
@pytest.mark.parametrize("size", [(160, 96), (99, 75), (5, 3)], ids=str)
@pytest.mark.parametrize("n", [0, 3, 3000])
def test_every_pixel_of_a_tile_without_gaussians_is_written(
    n: int, size: tuple[int, int], workers: int
) -> None:
    """None at all, few, or so many on a few tiles that most of their pixels stop before the lists end."""
    width, height = size
    scene = make_scene(1, n=max(n, 1), size=size, scale=(0.01, 0.03), opacity=(0.9, 0.99), spread=0.3)
    record = render([t.detach() for t in scene.tensors(torch.float32)], scene, 3)[2]["projected"][0]
    splats, bins = record.splats, record.bins
    tile_start, pair_gaussian = bins.tile_start, bins.pair_gaussian
    if n == 0:
        tile_start, pair_gaussian = np.zeros_like(tile_start), pair_gaussian[:0]
    n_tiles = len(tile_start) - 1
    image = np.full((height, width, FEATURES), np.nan, np.float32)
    transmittance = np.full((height, width), np.nan, np.float32)
    order = np.random.default_rng(workers).permutation(n_tiles).astype(np.int32)
    tables = (tile_start, pair_gaussian, TABLE, np.zeros(len(pair_gaussian), np.uint32))
    counter = np.zeros(1, np.int64)
    blend._forward(workers, order, counter, tables, (width, height), splats, image, transmittance, ALPHA_MIN)
    assert np.isfinite(image).all()
    assert np.isfinite(transmittance).all()
    empty = (np.diff(tile_start) == 0).reshape(-1, -(-width // TILE))
    blank = np.kron(empty, np.ones((TILE, TILE), bool))[:height, :width]
    assert blank.all() if n == 0 else not blank.all()
    assert blank.any() == (n == 0 or size != (5, 3))
    assert (image[blank] == 0).all()
    assert (transmittance[blank] == 1).all()
    assert n < 3000 or (transmittance < 1e-3).any()
