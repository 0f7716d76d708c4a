"""Adaptive density control: budget, what fades, what is split and how."""

import numpy as np
import pytest
import torch

from tg4mm.fit.space.density import DIM, EVERY, SHRINK, control_density, growth, is_due, split_rows
from tg4mm.fit.space.parameters import ParameterAdam

EXTENT = 2.0


def parameters(n, opacity=0.5, scale=0.05, seed=0):
    """n Gaussians; sh0's first entry is the row's number."""
    g = torch.Generator().manual_seed(seed)
    sh0 = torch.zeros(n, 1, 3)
    sh0[:, 0, 0] = torch.arange(n)
    return {
        "means": torch.randn(n, 3, generator=g),
        "quats": torch.randn(n, 4, generator=g),
        "log_scales": (scale * (0.5 + torch.rand(n, 3, generator=g))).log(),
        "logits": torch.full((n,), opacity).logit(),
        "sh0": sh0,
        "shn": torch.randn(n, 3, 3, generator=g),
    }


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def numbers(adam):
    return adam.parameters["sh0"][:, 0, 0].int().tolist()


def test_the_halves_of_a_split_keep_the_mass_centre():
    p = parameters(50)
    rows = torch.tensor([3, 7, 40])
    halves = split_rows(p, rows, generator())
    a, b = halves["means"][:3], halves["means"][3:]
    np.testing.assert_allclose((a + b) / 2, p["means"][rows], atol=1e-6)
    assert ((a - b).abs().amax(1) > 1e-3).all()
    for name in ("quats", "sh0", "shn"):
        assert torch.equal(halves[name], torch.cat([p[name][rows]] * 2))
    np.testing.assert_allclose(halves["logits"].sigmoid(), 0.5 * DIM, rtol=1e-5)
    shrunk = torch.cat([p["log_scales"][rows]] * 2).exp() / SHRINK
    np.testing.assert_allclose(halves["log_scales"].exp(), shrunk, rtol=1e-5)


@pytest.mark.parametrize("most", [40, 12])
def test_a_full_budget_splits_none(most):
    adam = ParameterAdam(parameters(40), EXTENT)
    change = control_density(adam, torch.ones(40), EXTENT, most, generator())
    assert change == (0, 0)
    assert numbers(adam) == list(range(40))


def test_growth_is_a_twentieth_beside_what_was_removed():
    p = parameters(40)
    p["logits"][:5] = -8.0
    adam = ParameterAdam(p, EXTENT)
    change = control_density(adam, torch.ones(40), EXTENT, 1000, generator())
    assert change == (5, 2 + 5)
    assert len(adam.parameters["means"]) == 40 - 5 + 7


@pytest.mark.parametrize(("start", "most", "iterations"), [(150, 10_000, 2_000), (4, 9_000, 20_000)])
def test_a_start_far_below_the_budget_reaches_it_in_time(start, most, iterations):
    """In equal steps, where twentieths would end at a fraction of it."""
    n, counts = start, []
    caught_up = 0.35 * iterations
    for iteration in filter(lambda i: is_due(i, iterations), range(1, iterations)):
        n = min(most, n + int(growth(n, most, iteration, caught_up) * n))
        counts.append(n)
        if iteration + EVERY > caught_up:
            break
    assert counts[-1] >= 0.95 * most
    if start > 10:  # below, whole Gaussians are coarse steps
        steps = np.array([start, *counts])
        assert np.ptp(steps[1:] / steps[:-1]) < 0.1


@pytest.mark.parametrize(("n", "iteration"), [(10_000, 200), (9_900, 200), (40_000, 3_000), (50_000, 9_000)])
def test_a_start_near_the_budget_grows_by_twentieths(n, iteration):
    """10,000 points and 40,000 Gaussians over 10,000 iterations."""
    most = 40_000 if n < 40_000 else n
    assert growth(n, most, iteration, 3_500) == pytest.approx(0.05)


def test_faded_and_huge_gaussians_are_removed_and_never_split():
    """However large their share of the error."""
    p = parameters(20)
    p["logits"][3] = torch.tensor(0.004).logit()
    p["logits"][4] = torch.tensor(0.006).logit()
    p["log_scales"][8, 1] = np.log(0.51 * EXTENT)
    p["log_scales"][9, 1] = np.log(0.49 * EXTENT)
    error = torch.zeros(20)
    error[[3, 8]] = 1e6
    error[5] = 1.0
    adam = ParameterAdam(p, EXTENT)
    change = control_density(adam, error, EXTENT, 1000, generator())
    assert change == (2, 1)
    assert sorted(numbers(adam)) == sorted([i for i in range(20) if i not in {3, 5, 8}] + [5, 5])


def test_the_chance_is_the_share_of_the_error():
    """10 Gaussians, one split a round: over 600 rounds the counts follow the error (χ², 9 degrees: 99.9 % < 27.9)."""
    error = torch.tensor([0.0, 1, 1, 2, 2, 3, 3, 4, 4, 20])
    counts, start = np.zeros(10), parameters(10)
    for seed in range(600):
        adam = ParameterAdam(start, EXTENT)
        control_density(adam, error, EXTENT, 1000, generator(seed), share=0.1)
        assert len(adam.parameters["means"]) == 11
        counts[numbers(adam)[-1]] += 1
    expected = 600 * (error / error.sum()).numpy()
    assert counts[0] == 0
    assert ((counts - expected)[1:] ** 2 / expected[1:]).sum() < 27.9
    # the check can fail: an even chance would not pass
    assert ((600 / 9 - expected)[1:] ** 2 / expected[1:]).sum() > 27.9
