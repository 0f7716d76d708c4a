"""Lists whose lengths lie around those of the batches in which they are blended, against a plain loop over pixels."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.fit.rasterize.oracle import make_scene, render
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.layout import (
    ALPHA_MAX,
    ALPHA_MIN,
    CA,
    CB,
    CC,
    FEAT,
    FEATURES,
    MX,
    MY,
    OP,
    T_MIN,
    TILE,
)
from tg4mm.fit.rasterize.kernels.tiles import BLOCKS, HEIGHT, WIDTH

_LONG = 150  # pairs of the tile in front, whose masks lie in memory when the next one's turn comes


@pytest.fixture(scope="module")
def splats() -> np.ndarray:
    """Gaussians that are seen by two tiles side by side, in a random order."""
    scene = make_scene(3, n=400, size=(2 * TILE, TILE), scale=(0.02, 0.08), opacity=(0.03, 0.3))
    record = render([t.detach() for t in scene.tensors(torch.float32)], scene, 3)[2]["projected"][0]
    seen = np.unique(record.bins.pair_gaussian)
    assert len(seen) >= _LONG
    return np.ascontiguousarray(record.splats[np.random.default_rng(0).permutation(seen)])


def composited(
    splats: np.ndarray, gaussians: np.ndarray, x0: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of a tile in float64: image, transmittance, where each pair is seen [P, blocks], and where that is sure."""
    y, x = np.mgrid[:TILE, :TILE] + 0.5
    x = x + x0
    image, transmittance = np.zeros((TILE, TILE, FEATURES)), np.ones((TILE, TILE))
    running = np.ones((TILE, TILE))
    seen, sure = [], []

    def any_of_block(mask: np.ndarray) -> np.ndarray:
        return mask.reshape(TILE // HEIGHT, HEIGHT, TILE // WIDTH, WIDTH).any((1, 3)).ravel()

    for row in splats[gaussians].astype(np.float64):
        dx, dy = x - row[MX], y - row[MY]
        sigma = (row[CA] * dx * dx + row[CC] * dy * dy) / 2 + row[CB] * dx * dy
        alpha = np.minimum(row[OP] * np.exp(-sigma), ALPHA_MAX)
        on, bright = running > T_MIN, alpha >= ALPHA_MIN
        seen.append(any_of_block(on & bright))
        near = (abs(alpha / ALPHA_MIN - 1) < 1e-3) | (abs(running / T_MIN - 1) < 1e-2)
        sure.append(~any_of_block(near))
        weight = np.where(bright, alpha, 0) * running
        running = running - weight
        adds = running > T_MIN
        transmittance = np.where(adds, running, transmittance)
        image += np.where(adds, weight, 0)[..., None] * row[FEAT : FEAT + FEATURES]
    return image, transmittance, np.array(seen), np.array(sure)


@pytest.mark.parametrize("count", [0, 1, 2, 15, 16, 17, 31, 32, 33, 63, 64, 65, 127, 128, 129])
def test_a_list_of_any_length_is_blended_to_its_end(splats: np.ndarray, count: int) -> None:
    """A long list, then one of `count` pairs, with and without a list of the blocks in which each pair is seen."""
    gaussians = np.concatenate([np.arange(_LONG), np.arange(count)[::-1]]).astype(np.uint32)
    tile_start = np.array([0, _LONG, _LONG + count], np.int32)
    pictures = []
    reached = np.full(len(gaussians), 0xDEADBEEF, np.uint32)
    for noted in (reached, None):
        image = np.full((TILE, 2 * TILE, FEATURES), np.nan, np.float32)
        transmittance = np.full((TILE, 2 * TILE), np.nan, np.float32)
        blend_forward(splats, tile_start, gaussians, 2 * TILE, TILE, image, transmittance, reached=noted)
        pictures.append((image, transmittance))
    for a, b in zip(*pictures, strict=True):
        np.testing.assert_array_equal(a, b)
    for tile in (0, 1):
        first, last, here = tile_start[tile], tile_start[tile + 1], slice(tile * TILE, (tile + 1) * TILE)
        image, transmittance, seen, sure = composited(splats, gaussians[first:last], tile * TILE)
        np.testing.assert_allclose(pictures[0][0][:, here], image, atol=2e-5)
        np.testing.assert_allclose(pictures[0][1][:, here], transmittance, atol=2e-5)
        if first == last:
            continue
        assert sure.mean() > 0.8
        found = (reached[first:last, None] >> np.arange(BLOCKS) & 1).astype(bool)
        np.testing.assert_array_equal(found[sure], seen[sure])
        assert 0 < seen.mean() < 1 or count < 3
