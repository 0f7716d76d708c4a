"""Sampling at fixed points and the decoder, against plain torch."""

import numpy as np
import pytest
import torch
from torch.nn.functional import grid_sample

from tg4mm.fit.gaussians import Gaussians
from tg4mm.research.paper import triplane
from tg4mm.research.paper.triplane import BASE, PLANES, base_below, cells_of, new_decoder, sample, scene_box

R, C, N = 16, 8, 60


@pytest.fixture
def points():
    return np.random.default_rng(0).normal(size=(N, 3)) * [1.0, 0.5, 2.0]


def dense_sample(planes, points, box):
    """The twin: planes [3, C, R, R] by torch's grid_sample."""
    unit = torch.from_numpy((points - box[0]) / (box[1] - box[0]) * 2 - 1).to(planes)
    parts = [
        grid_sample(planes[k : k + 1], unit[None, None][..., list(axes)], "bilinear", "border", True)
        for k, axes in enumerate(PLANES)
    ]
    return torch.cat([part[0, :, 0].T for part in parts], 1)


def active(planes, dense):
    return planes.permute(0, 2, 3, 1).reshape(-1, planes.shape[1])[torch.from_numpy(dense)]


def test_values_and_gradients_are_those_of_dense_planes(points):
    box = scene_box(points)
    cells = cells_of(points, box, R)
    planes = torch.randn(3, C, R, R, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    planes.requires_grad_()
    values = active(planes.detach(), cells.dense).float().requires_grad_()
    expected, got = dense_sample(planes, points, box), sample(values, cells)
    torch.testing.assert_close(got.double(), expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(triplane.sample_torch(values.double(), cells), expected, atol=1e-6, rtol=0)
    v = torch.randn(N, 3 * C, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    expected.backward(v)
    got.backward(v.float())
    assert planes.grad is not None
    torch.testing.assert_close(values.grad.double(), active(planes.grad, cells.dense), atol=1e-5, rtol=0)
    others = np.setdiff1d(np.arange(3 * R * R), cells.dense)
    assert not active(planes.grad, others).any()


def test_adam_on_active_cells_is_adam_on_dense_planes(points):
    """Cells that no point touches never get a gradient: dense Adam leaves them bit for bit."""
    box = scene_box(points)
    cells = cells_of(points, box, R)
    generator = torch.Generator().manual_seed(3)
    start = torch.randn(3, C, R, R, generator=generator)
    target = torch.randn(N, 3 * C, generator=generator)
    planes = start.clone().requires_grad_()
    values = active(start, cells.dense).clone().requires_grad_()
    dense_adam = torch.optim.Adam([planes], lr=1e-2)
    compact_adam = torch.optim.Adam([values], lr=1e-2, fused=True)
    for _ in range(50):
        dense = dense_sample(planes, points, box)
        for optimiser, out in ((dense_adam, dense), (compact_adam, sample(values, cells))):
            optimiser.zero_grad()
            ((out - target) ** 2).sum().backward()
            optimiser.step()
    torch.testing.assert_close(values, active(planes, cells.dense), atol=2e-5, rtol=0)
    assert (values - active(start, cells.dense)).abs().max() > 0.1  # and they did move
    others = np.setdiff1d(np.arange(3 * R * R), cells.dense)
    assert torch.equal(active(planes.detach(), others), active(start, others))


def test_results_do_not_depend_on_the_number_of_threads(points):
    import numba

    cells = cells_of(points, scene_box(points), R)
    values = torch.randn(len(cells), C, generator=torch.Generator().manual_seed(0))
    before = numba.get_num_threads()
    results = []
    for threads in (1, before):
        numba.set_num_threads(threads)
        x = values.clone().requires_grad_()
        out = sample(x, cells)
        out.square().sum().backward()
        results.append((out.detach(), x.grad))
    numba.set_num_threads(before)
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])


@pytest.fixture
def gaussians():
    g = torch.Generator().manual_seed(0)
    return Gaussians(
        torch.randn(5, 3, generator=g), torch.randn(5, 4, generator=g), torch.rand(5, 3, generator=g) + 0.01,
        torch.rand(5, generator=g) * 0.9 + 0.05, torch.randn(5, 16, 3, generator=g),
    )  # fmt: skip


@pytest.mark.parametrize("layers", [0, 8])
def test_on_the_base_below_them_an_embedding_decodes_to_the_gaussians(gaussians, layers):
    decoder = new_decoder(12, 16, layers, 32, torch.Generator().manual_seed(0))
    embedding = torch.randn(5, 12)
    out = decoder.decode(base_below(gaussians, decoder, embedding), embedding)
    assert decoder.n_layers == layers
    assert all(decoder.parameters[f"{head}.weight"].any() for head in BASE)
    for name in ("means", "scales", "opacities", "sh"):
        torch.testing.assert_close(getattr(out, name), getattr(gaussians, name))
    torch.testing.assert_close(out.quats, torch.nn.functional.normalize(gaussians.quats, dim=1))
