"""The optimiser: torch's own Adam, whose rows may come and go."""

import numpy as np
import pytest
import torch

from tests.helpers.space_parameters import EXTENT, N, gradients, take_step
from tg4mm.fit.space.fused import FusedAdam
from tg4mm.fit.space.initial import InitialPoints
from tg4mm.fit.space.parameters import LEARNING_RATES, SH_C0, ParameterAdam, activate, initial_parameters

NEW = -1  # in what `expected` says of a row: it holds the next of those added


def points(n=N):
    rng = np.random.default_rng(0)
    xyz, rgb, spacing = rng.normal(size=(n, 3)), rng.uniform(size=(n, 3)), rng.uniform(0.01, 0.2, n)
    return InitialPoints(*(a.astype(np.float32) for a in (xyz, rgb, spacing)), "points")


def parameters(degree=1):
    return initial_parameters(points(), degree, torch.Generator().manual_seed(0))


def rows(values, keep):
    return {k: v[keep] for k, v in values.items()}


@pytest.mark.parametrize("degree", [0, 3])
def test_initial_gaussians_are_round_and_show_the_colour(degree):
    start = points()
    g = activate(initial_parameters(start, degree, torch.Generator().manual_seed(0)))
    assert g.sh.shape == (N, (degree + 1) ** 2, 3)
    np.testing.assert_allclose(g.means, start.xyz)
    np.testing.assert_allclose(g.scales, np.repeat(start.spacing[:, None], 3, 1), rtol=1e-5)
    np.testing.assert_allclose(g.opacities, 0.3, rtol=1e-5)
    np.testing.assert_allclose(0.5 + SH_C0 * g.sh[:, 0], start.rgb, atol=1e-6)
    assert (g.sh[:, 1:] == 0).all()
    np.testing.assert_allclose(torch.linalg.vector_norm(g.quats, dim=1), 1, rtol=1e-6)


def rate(name, progress):
    """The schedule in words: means fall to 1 % exponentially, the others to 10 % over the second half."""
    if name == "means":
        return 1.6e-3 * EXTENT * 0.01**progress
    return LEARNING_RATES[name] * (1 if progress <= 0.5 else 0.1 ** ((progress - 0.5) / 0.5))


def test_it_is_torch_adam_while_nothing_comes_or_goes():
    adam = ParameterAdam(parameters(), EXTENT)
    plain = {k: v.clone().requires_grad_() for k, v in parameters().items()}
    groups = [{"params": [p], "name": k} for k, p in plain.items()]
    reference = torch.optim.Adam(groups, eps=1e-15, foreach=False, fused=False)
    for i, progress in enumerate([0.0, 0.2, 0.5, 0.7, 1.0]):
        grads = gradients(plain, i)
        take_step(adam, grads, progress)
        for group in reference.param_groups:
            group["lr"] = rate(group["name"], progress)
        for name, p in plain.items():
            p.grad = grads[name]
        reference.step()
    for name, p in plain.items():
        np.testing.assert_allclose(adam.parameters[name].detach(), p.detach(), rtol=2e-6, atol=1e-7)
        assert (p.detach() - parameters()[name]).abs().max() > 3 * LEARNING_RATES[name] * 0.1


@pytest.mark.parametrize(
    ("gone", "n_added", "expected"),
    [
        ([4, 0], 2, [NEW, 1, 2, 3, NEW, 5]),
        ([4, 0], 4, [NEW, 1, 2, 3, NEW, 5, NEW, NEW]),
        ([4, 0, 2], 1, [1, 3, NEW, 5]),
        ([4, 0], 0, [1, 2, 3, 5]),
        ([], 2, [0, 1, 2, 3, 4, 5, NEW, NEW]),
        ([], 0, [0, 1, 2, 3, 4, 5]),
    ],
)
@pytest.mark.parametrize("kind", [ParameterAdam, FusedAdam])
def test_kept_rows_keep_their_moments_and_new_ones_start_at_zero(kind, gone, n_added, expected):
    plain = ParameterAdam(parameters(), EXTENT)
    for i in range(3):
        take_step(plain, gradients(plain.parameters, i))
    before = {k: v.detach().clone() for k, v in (plain.parameters | plain.moments()).items()}
    adam = kind(plain.parameters, EXTENT, plain.moments())
    added = rows(parameters(), torch.arange(n_added) % N)
    adam.replace(torch.tensor(gone, dtype=torch.long), added)
    after = adam.moments()
    assert after["step"] == 3
    stay, new = torch.tensor(expected) != NEW, torch.tensor(expected) == NEW
    old = torch.tensor(expected)[stay]
    for name, p in adam.parameters.items():
        assert torch.equal(p[stay], before[name][old])
        assert sorted(p[new].flatten(1 if p.dim() > 1 else 0).tolist()) == sorted(
            added[name].flatten(1 if p.dim() > 1 else 0).tolist()
        )
        for moment in (".m", ".v"):
            assert (before[name + moment] != 0).any()
            assert torch.equal(after[name + moment][stay], before[name + moment][old])
            assert (after[name + moment][new] == 0).all()
            assert after[name + moment].shape == p.shape
