"""What the forward pass tells the backward pass: in which blocks of its tile each Gaussian is seen."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.fit.rasterize.oracle import make_scene, render
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, ALPHA_MIN, CA, CB, CC, MX, MY, OP, T_MIN, TILE
from tg4mm.fit.rasterize.kernels.tiles import COLUMNS, HEIGHT, WIDTH


def blocks_of_pixel(tile: np.ndarray) -> np.ndarray:
    """The block of each pixel of a tile, as a bit."""
    rows, columns = tile // TILE, tile % TILE
    return np.uint32(1) << (rows // HEIGHT * COLUMNS + columns // WIDTH).astype(np.uint32)


@pytest.mark.parametrize("opacity", ["as made", "nearly opaque"])
def test_a_pair_reaches_the_blocks_with_a_pixel_that_sees_it(opacity: str) -> None:
    """Tiles with more pairs than a batch of 64; with opaque Gaussians most pixels stop on the way."""
    scene = make_scene(3, n=600, size=(40, 28), scale=(0.02, 0.15))
    tensors = [t.detach() for t in scene.tensors(torch.float32)]
    if opacity == "nearly opaque":
        tensors[3] = torch.full_like(tensors[3], 0.995)
    record = render(tensors, scene, 3)[2]["projected"][0]
    splats, bins = record.splats.astype(np.float64), record.bins
    n_x = -(-scene.width // TILE)
    places = np.arange(TILE * TILE)
    bit = blocks_of_pixel(places)
    stopped, longest = 0, 0
    for tile in range(len(bins.tile_start) - 1):
        x, y = tile % n_x * TILE + places % TILE, tile // n_x * TILE + places // TILE
        inside = (x < scene.width) & (y < scene.height)
        left, sure = np.ones(TILE * TILE), inside.copy()
        on = inside.copy()
        longest = max(longest, bins.tile_start[tile + 1] - bins.tile_start[tile])
        for pair in range(bins.tile_start[tile], bins.tile_start[tile + 1]):
            s = splats[bins.pair_gaussian[pair]]
            dx, dy = x + 0.5 - s[MX], y + 0.5 - s[MY]
            raw = s[OP] * np.exp(-(s[CA] * dx**2 + s[CC] * dy**2) / 2 - s[CB] * dx * dy)
            seen, near = raw >= ALPHA_MIN, np.abs(raw / ALPHA_MIN - 1) < 1e-3
            found = int(bins.reached[pair])
            assert np.bitwise_or.reduce(bit[on & sure & seen & ~near], initial=0) & ~found == 0
            possible = np.bitwise_or.reduce(bit[(on | ~sure) & (seen | near)], initial=0)
            assert found & ~possible == 0
            after = np.where(seen, left * (1 - np.minimum(raw, ALPHA_MAX)), left)
            sure &= ~(near & on) & (np.abs(after / T_MIN - 1) > 1e-2)
            on &= after > T_MIN
            left = np.where(on, after, left)
        stopped += int((inside & ~on).sum())
    assert longest > 64
    assert (stopped > 200) == (opacity == "nearly opaque")
