"""The same bits for any number of threads and on every run, values and gradients."""

import numba
import pytest
import torch

from tests.fit.rasterize.oracle import make_scene, render


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
    image, alpha, _ = render(tensors, scene, 3, render_mode="RGB+D")
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
