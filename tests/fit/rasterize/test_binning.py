"""Depth order and tile lists against brute force: complete, tight, in order, with the same bits on every run."""

from dataclasses import replace

import numba
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.fit.rasterize.oracle import make_scene, render
from tg4mm.fit.rasterize.kernels import binning
from tg4mm.fit.rasterize.kernels.binning import bin_splats, depth_order
from tg4mm.fit.rasterize.kernels.layout import DEPTH, POWER, SPLAT_WIDTH

depths = st.floats(float(np.float32(0.01)), float(np.float32(3e38)), width=32) | st.sampled_from(
    [np.float32(1.0), np.float32(2.5)]
)
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


@settings(max_examples=60, deadline=None)
@given(data=st.data(), n=st.integers(0, 300))
def test_depth_order_is_the_stable_sort_of_the_visible(data, n):
    splats = np.full((n, SPLAT_WIDTH), np.nan, np.float32)
    splats[:, DEPTH] = data.draw(arrays(np.float32, n, elements=depths))
    splats[:, POWER] = data.draw(arrays(np.float32, n, elements=st.sampled_from([-1.0, 0.0, 0.0078125, 5.0])))
    keys, keys2 = np.empty(n, np.uint32), np.empty(n, np.uint32)
    scratch, order = np.empty(n, np.int32), np.empty(n, np.int32)
    n_visible = depth_order(splats, keys, scratch, keys2, order)
    visible = np.flatnonzero(splats[:, POWER] > 0)
    expected = visible[np.argsort(splats[visible, DEPTH], kind="stable")]
    np.testing.assert_array_equal(order[:n_visible], expected)


@pytest.mark.parametrize("name", ["ordinary", "large", "faint"])
def test_lists_that_do_not_fit_are_made_again(name, monkeypatch):
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


@pytest.fixture(scope="module")
def scene():
    return make_scene(0, n=4000, size=(99, 75), scale=(0.005, 0.1), cameras=2)


@pytest.fixture(autouse=True)
def _keep_thread_count():
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


def everything(scene):
    """Image, alpha, and the gradient by every input."""
    tensors = scene.tensors(torch.float32)
    image, alpha, _ = render(tensors, scene, 3)
    weight = torch.randn(image.shape, generator=torch.Generator().manual_seed(1))
    ((image * weight).sum() + alpha.square().sum()).backward()
    return [image.detach(), alpha.detach()] + [t.grad for t in tensors if t.grad is not None]


def test_the_number_of_threads_does_not_change_a_bit(scene):
    most = numba.config.NUMBA_NUM_THREADS
    if most < 2:
        pytest.skip(f"numba has {most} thread here; comparing thread counts needs 2")
    results = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        results.append(everything(scene))
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))
    assert all(a.any() for a in results[0])
