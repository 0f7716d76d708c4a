"""Depth order and tile lists against brute force: complete, tight, in order."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.fit.rasterize.oracle import Scene, make_scene, render
from tg4mm.fit.rasterize.kernels import binning
from tg4mm.fit.rasterize.kernels.binning import Bins, bin_splats, depth_order
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MIN, DEPTH, POWER, SPLAT_WIDTH, TILE
from tg4mm.fit.rasterize.reference import project

depths = st.floats(float(np.float32(0.01)), float(np.float32(3e38)), width=32) | st.sampled_from(
    [np.float32(1.0), np.float32(2.5)]
)


@settings(max_examples=60, deadline=None)
@given(data=st.data(), n=st.integers(0, 300))
def test_depth_order_is_the_stable_sort_of_the_visible(data: st.DataObject, n: int) -> None:
    splats = np.full((n, SPLAT_WIDTH), np.nan, np.float32)
    splats[:, DEPTH] = data.draw(arrays(np.float32, n, elements=depths))
    splats[:, POWER] = data.draw(arrays(np.float32, n, elements=st.sampled_from([-1.0, 0.0, 0.0078125, 5.0])))
    keys, keys2 = np.empty(n, np.uint32), np.empty(n, np.uint32)
    scratch, order = np.empty(n, np.int32), np.empty(n, np.int32)
    n_visible = depth_order(splats, keys, scratch, keys2, order)
    visible = np.flatnonzero(splats[:, POWER] > 0)
    expected = visible[np.argsort(splats[visible, DEPTH], kind="stable")]
    np.testing.assert_array_equal(order[:n_visible], expected)


SCENES = {
    "ordinary": make_scene(0, n=200, size=(100, 70)),
    "small": make_scene(1, n=300, size=(100, 70), scale=(1e-4, 2e-2)),
    "large": make_scene(2, n=60, size=(100, 70), scale=(0.3, 3.0), spread=2.0),
    "needles": make_scene(3, n=200, size=(100, 70), scale=(1e-4, 1.5)),
    "across the edges": make_scene(4, n=300, size=(100, 70), spread=4.0, distance=6.0),
    "faint": make_scene(5, n=200, size=(100, 70), opacity=(0.0, 0.02)),
    "sharp needles": replace(
        make_scene(6, n=60, size=(100, 70)), scales=torch.tensor([[8.0, 1e-3, 1e-3]]).double().repeat(60, 1)
    ),
}


def bins_of(scene: Scene) -> Bins:
    _, _, meta = render([t.detach() for t in scene.tensors(torch.float32)], scene, 3)
    return meta["projected"][0].bins


def listed(bins: Bins, n_tiles: int, n: int) -> np.ndarray:
    """[tiles, N] bool: which pairs the lists hold; checks that none is there twice."""
    found = np.zeros((n_tiles, n), int)
    for tile in range(n_tiles):
        np.add.at(found[tile], bins.pair_gaussian[bins.tile_start[tile] : bins.tile_start[tile + 1]], 1)
    assert found.max() <= 1
    return found == 1


def edge_minimum(
    A: np.ndarray, fixed: np.ndarray, axis: int, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Least ½ dᵀA d with d[axis] = fixed, the other coordinate in [low, high]. A [N, 2, 2], the rest [N]."""
    a, b, c = A[:, 1 - axis, 1 - axis], A[:, 0, 1], A[:, axis, axis]
    free = np.clip(-b * fixed / a, low, high)
    return 0.5 * (a * free**2 + 2 * b * free * fixed + c * fixed**2)


def least_exponent(uv: np.ndarray, A: np.ndarray, x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    """Least ½ dᵀA d of each Gaussian over a rectangle [N]: inside it 0, else on one of its four edges."""
    left, right, top, bottom = x0 - uv[:, 0], x1 - uv[:, 0], y0 - uv[:, 1], y1 - uv[:, 1]
    edges = [
        edge_minimum(A, left, 0, top, bottom),
        edge_minimum(A, right, 0, top, bottom),
        edge_minimum(A, top, 1, left, right),
        edge_minimum(A, bottom, 1, left, right),
    ]
    inside = (left <= 0) & (right >= 0) & (top <= 0) & (bottom >= 0)
    return np.where(inside, 0.0, np.min(edges, axis=0))


@pytest.mark.parametrize("name", SCENES)
def test_tile_lists_are_complete_and_tight(name: str) -> None:
    """Complete: each tile with a pixel of alpha >= 1/255. Tight: none whose pixel square the ellipse misses.

    In float64 and from the parameters. The margin, 0.3 % of alpha, is float32's error in the exponent of the
    thinnest ellipses here.
    """
    scene, margin = SCENES[name], 3e-3
    uv_, cov, depth_ = project(
        scene.means, scene.quats, scene.scales, scene.viewmats[0], scene.Ks[0], scene.width, scene.height, 0.3
    )
    uv, A, depth = uv_.numpy(), np.linalg.inv(cov.numpy()), depth_.numpy()
    opacities = scene.opacities.numpy()
    power = np.where(depth > 0.01, np.log(np.maximum(opacities, 1e-20) / ALPHA_MIN), -np.inf)
    n_x, n_y = -(-scene.width // TILE), -(-scene.height // TILE)
    found = listed(bins_of(scene), n_x * n_y, len(uv))
    missing = spare = wanted = 0
    for tile in range(n_x * n_y):
        x0, y0 = (tile % n_x) * TILE + 0.5, (tile // n_x) * TILE + 0.5
        xs = np.arange(x0, min(x0 + TILE, scene.width))
        ys = np.arange(y0, min(y0 + TILE, scene.height))
        d = np.stack(np.meshgrid(xs, ys), -1).reshape(-1, 2) - uv[:, None]
        exponent = 0.5 * np.einsum("npi,nij,npj->np", d, A, d).min(1)
        needed = exponent < power - margin
        touched = least_exponent(uv, A, x0, y0, x0 + TILE - 1, y0 + TILE - 1) <= power + margin
        wanted += needed.sum()
        missing += (needed & ~found[tile]).sum()
        spare += (found[tile] & ~touched).sum()
    assert wanted > 60
    assert missing == 0
    assert spare == 0


@pytest.mark.parametrize("name", ["ordinary", "large", "faint"])
def test_lists_that_do_not_fit_are_made_again(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The room for lists is a guess; too small or too large, the lists are the same."""
    scene = SCENES[name]
    splats = render([t.detach() for t in scene.tensors(torch.float32)], scene, 3)[2]["projected"][0].splats
    found = []
    for guess in (0, 1, 50):
        monkeypatch.setattr(binning, "_PAIRS_EXPECTED", guess)
        found.append(bin_splats(splats, scene.width, scene.height))
    assert len(found[0].pair_gaussian) > 60
    for key in ("order", "tile_start", "gaussian_start", "pair_gaussian", "pair_slot"):
        n = found[0].n_visible if key == "order" else None
        for other in found[1:]:
            np.testing.assert_array_equal(getattr(found[0], key)[:n], getattr(other, key)[:n])
