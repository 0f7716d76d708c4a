"""The motion triplane's sampling matrix."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.motion.triplane import _FREE_SHARE, resolutions, sampling_matrix

PLANES = ((0, 1), (0, 2), (1, 2))


def means(n: int = 400, seed: int = 0) -> np.ndarray:
    """In a box whose sides differ."""
    return (np.random.default_rng(seed).uniform(-1, 1, (n, 3)) * [2.0, 1.0, 0.5] + [3, 0, -1]).astype(
        np.float32
    )


def levels(finest: int) -> list[tuple[int, slice]]:
    """Resolution and columns of every plane, in the order of the matrix."""
    out, first = [], 0
    for r in resolutions(finest):
        for _ in PLANES:
            out.append((r, slice(first, first + r * r)))
            first += r * r
    return out


@pytest.mark.parametrize(
    ("finest", "expected"), [(8, [8]), (9, [8]), (16, [8, 16]), (64, [8, 16, 32, 64]), (7, [])]
)
def test_resolutions_double_from_eight(finest: int, expected: list[int]) -> None:
    assert resolutions(finest) == expected


@pytest.mark.parametrize("finest", [8, 16])
def test_every_plane_is_an_average(finest: int) -> None:
    """Weights of a row lie in 0..1 and sum to 1, at most four of them; the last level is a value of one's own."""
    S = sampling_matrix(means(), finest)
    assert S.dtype == np.float32
    assert S.shape == (400, sum(3 * r * r for r in resolutions(finest)) + 400)
    for _, columns in levels(finest):
        plane = S[:, columns]
        np.testing.assert_allclose(plane.sum(1), 1, atol=1e-5)
        assert plane.min() >= 0
        assert (plane > 0).sum(1).max() <= 4
    np.testing.assert_allclose(S[:, -400:].toarray(), _FREE_SHARE * np.eye(400), atol=1e-7)


@pytest.mark.parametrize("finest", [8, 16])
def test_bilinear_functions_are_reproduced(finest: int) -> None:
    """f(a, b) = 1 + 2a − 3b + 4ab of a plane's two coordinates, its values on the nodes given."""
    xyz = means()
    low, high = np.percentile(xyz, [1, 99], axis=0)
    side = (high - low).max()
    inside = ((xyz >= low) & (xyz <= low + side)).all(1)
    assert inside.sum() > 350
    f = lambda a, b: 1 + 2 * a - 3 * b + 4 * a * b  # noqa: E731
    S = sampling_matrix(xyz, finest)
    for (r, columns), axes in zip(levels(finest), PLANES * len(resolutions(finest)), strict=True):
        node = np.linspace(0, 1, r)
        values = f(node[:, None], node[None]).ravel()
        u = (xyz[:, axes] - low[list(axes)]) / side
        np.testing.assert_allclose((S[:, columns] @ values)[inside], f(u[:, 0], u[:, 1])[inside], atol=2e-5)


def test_what_lies_outside_takes_the_value_at_the_border() -> None:
    xyz = means()
    far = np.concatenate([xyz, [[100.0, 0, -1]], [[3.0, -100, -1]]]).astype(np.float32)
    S = sampling_matrix(far, 8)
    values = np.arange(64.0)  # grows along the first axis by 8 a node
    top = S[400, :64] @ values
    assert 56 <= float(top[0]) <= 63
    assert 0 <= float((S[401, :64] @ values)[0]) <= 63


def test_points_on_one_spot_are_no_trouble() -> None:
    S = sampling_matrix(np.ones((5, 3), np.float32), 8)
    assert np.isfinite(S.data).all()
    np.testing.assert_allclose(S[:, :64].sum(1), 1, atol=1e-6)
