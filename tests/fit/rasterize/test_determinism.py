"""The same bits for any number of threads and on every run, values and gradients."""

from collections.abc import Iterator

import numba
import numpy as np
import pytest
import torch

from tests.fit.rasterize.oracle import Scene, make_scene, render
from tg4mm.fit.rasterize.kernels import blend, blend_backward
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MIN, FEAT, FEATURES, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.tiles import TABLE


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(0, n=4000, size=(99, 75), scale=(0.005, 0.1), cameras=2)


@pytest.fixture(autouse=True)
def _keep_thread_count() -> Iterator[None]:
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


def everything(scene: Scene) -> list[torch.Tensor]:
    """Image, alpha, and the gradient by every input."""
    tensors = scene.tensors(torch.float32)
    image, alpha, _ = render(tensors, scene, 3, render_mode="RGB+D")
    weight = torch.randn(image.shape, generator=torch.Generator().manual_seed(1))
    ((image * weight).sum() + alpha.square().sum()).backward()
    return [image.detach(), alpha.detach()] + [t.grad for t in tensors if t.grad is not None]


def test_the_number_of_threads_does_not_change_a_bit(scene: Scene) -> None:
    most = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    if most < 2:
        pytest.skip(f"numba has {most} thread here; comparing thread counts needs 2")
    results = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        results.append(everything(scene))
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))
    assert all(a.any() for a in results[0])


@pytest.mark.parametrize("workers", [1, 2, 7])
def test_neither_the_order_of_tiles_nor_who_takes_them_changes_a_bit(scene: Scene, workers: int) -> None:
    """35 tiles in a random order, by fewer and by more workers than there are processors."""
    tensors = [t.detach() for t in scene.tensors(torch.float32)]
    record = render(tensors, scene, 3)[2]["projected"][0]
    splats, bins, (width, height) = record.splats, record.bins, (scene.width, scene.height)
    rng = np.random.default_rng(workers)
    v_image = rng.normal(size=(height, width, FEATURES)).astype(np.float32)
    v_transmittance = rng.normal(size=(height, width)).astype(np.float32)

    def both(workers: int, order: np.ndarray) -> list[np.ndarray]:
        image, transmittance = np.empty_like(v_image), np.empty_like(v_transmittance)
        pair_sums = np.full((len(bins.pair_gaussian), SPLAT_WIDTH), np.nan, np.float32)
        reached = np.full(len(bins.pair_gaussian), 1 << 31, np.uint32)
        tables = (bins.tile_start, bins.pair_gaussian, TABLE, reached)
        start = (workers, order.astype(np.int32))
        frame = (width, height)
        pictures = (image, transmittance, v_image, v_transmittance)
        counter = np.zeros(1, np.int64)
        blend._forward(*start, counter, tables, frame, splats, image, transmittance, ALPHA_MIN)
        counter = np.zeros(1, np.int64)
        gradients = (pictures, pair_sums.reshape(-1))
        blend_backward._backward(*start, counter, tables, frame, splats, *gradients, ALPHA_MIN)
        return [image, transmittance, pair_sums, reached]

    n_tiles = len(bins.tile_start) - 1
    expected, actual = both(1, np.arange(n_tiles)), both(workers, rng.permutation(n_tiles))
    for a, b in zip(actual, expected, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.isfinite(expected[2]).all()
    assert expected[2].any(0)[: FEAT + FEATURES].all()
