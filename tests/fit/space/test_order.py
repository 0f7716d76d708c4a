"""The order of Gaussians in memory: a permutation, along which steps are short."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tg4mm.fit.space import density
from tg4mm.fit.space.order import along_a_curve, is_due


def lattice(n: int) -> Tensor:
    """Places [n³, 3] in a random order."""
    axes = torch.arange(n).float()
    return torch.cartesian_prod(axes, axes, axes)[
        torch.randperm(n**3, generator=torch.Generator().manual_seed(0))
    ]


def test_cubes_of_a_lattice_come_one_after_the_other() -> None:
    """Of 16³ places each eighth of the order fills one octant, each 64th a part of it, and so on."""
    places = lattice(16)
    ordered = places[along_a_curve(places)]
    for side in (8, 4, 2):
        cubes = (ordered // side).reshape(-1, side**3, 3)
        assert (cubes == cubes[:, :1]).all()


def test_one_far_away_does_not_blur_the_others() -> None:
    places = lattice(8)
    ordered = places[along_a_curve(torch.cat([places, torch.full((1, 3), 5e3)]))[:-1]]
    steps = ordered.diff(dim=0).norm(dim=1)
    assert steps.mean() < 2  # 4.9 at random


@pytest.mark.parametrize("n", [0, 1, 3])
def test_the_few_and_the_equal_keep_their_order(n: int) -> None:
    assert along_a_curve(torch.ones(n, 3)).tolist() == list(range(n))


def test_it_is_due_now_and_then_and_after_the_last_round() -> None:
    rounds = [i for i in range(1, 2000) if density.is_due(i, 1320)]
    assert [i for i in rounds if is_due(i, 1320)] == [500, 1000, 1300]
