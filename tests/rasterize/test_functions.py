"""The kernels' functions: vectors of lanes, the exponential, spherical harmonics and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numba import njit

from tg4mm.rasterize.kernels.sh import basis, basis_vjp
from tg4mm.rasterize.kernels.vector import LANES, bits, exp2, lane_sums, load, select, store, store_ten
from tg4mm.rasterize.reference import sh_colours


@njit
def _exp2(x: np.ndarray, out: np.ndarray) -> None:
    for i in range(0, len(x), LANES):
        store(out, i, exp2(load(x, i)))


@njit
def _lane_sums(x: np.ndarray, out: np.ndarray) -> None:
    a, b, c, d, e = load(x, 0), load(x, 16), load(x, 32), load(x, 48), load(x, 64)
    f, g, h, i, j = load(x, 80), load(x, 96), load(x, 112), load(x, 128), load(x, 144)
    store_ten(out, 1, lane_sums(a, b, c, d, e, f, g, h, i, j))


@njit
def _positive(x: np.ndarray, out: np.ndarray) -> int:
    value = load(x, 0)
    store(out, 0, select(value > np.float32(0), value, np.float32(-2)))
    return bits(value > np.float32(0))


@njit
def _basis(degree: int, d: np.ndarray, out: np.ndarray) -> None:
    basis(degree, d[0], d[1], d[2], out)


@njit
def _basis_vjp(degree: int, d: np.ndarray, v: np.ndarray) -> tuple[float, float, float]:
    return basis_vjp(degree, d[0], d[1], d[2], v)


def test_exp2_is_as_accurate_as_it_says() -> None:
    x = -np.linspace(0, 126, 400_000, dtype=np.float32)
    out = np.empty_like(x)
    _exp2(x, out)
    assert np.abs(out.astype(np.float64) / np.exp2(x.astype(np.float64)) - 1).max() < 3e-7
    assert out[0] == 1.0


def test_lane_sums_keep_the_vectors_apart() -> None:
    x = np.random.default_rng(0).normal(size=(10, LANES)).astype(np.float32)
    out = np.full(12, 9.0, np.float32)
    _lane_sums(x.ravel(), out)
    np.testing.assert_allclose(out[1:11], x.sum(1, dtype=np.float64), atol=1e-5)
    assert out[0] == out[11] == 9.0


def test_masks_and_selection() -> None:
    x = np.random.default_rng(1).normal(size=LANES).astype(np.float32)
    out = np.empty(LANES, np.float32)
    mask = _positive(x, out)
    np.testing.assert_array_equal(out, np.where(x > 0, x, np.float32(-2.0)))
    assert [mask >> k & 1 for k in range(LANES)] == (x > 0).astype(int).tolist()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_basis_is_the_twins(degree: int) -> None:
    n = (degree + 1) ** 2
    for direction in np.random.default_rng(degree).normal(size=(20, 3)):
        unit = direction / np.linalg.norm(direction)
        out = np.full(16, 9.0, np.float32)
        _basis(degree, unit.astype(np.float32), out)
        coefficients = 0.1 * torch.eye(n, dtype=torch.float64)[:, :, None].repeat(1, 1, 3)
        twin = (sh_colours(coefficients, torch.from_numpy(unit).expand(n, 3))[:, 0] - 0.5) / 0.1
        np.testing.assert_allclose(out[:n], twin.numpy(), atol=1e-6)
        assert (out[n:] == 9.0).all()


def polynomials(d: torch.Tensor) -> torch.Tensor:
    """The 16 basis polynomials at d, not normalised: from Legendre functions, not from the twin."""
    x, y, z = d.unbind(-1)
    cos, sin = [torch.ones_like(x)], [torch.zeros_like(x)]  # r^m cos mφ, r^m sin mφ, r² = x² + y²
    for _ in range(3):
        cos, sin = cos + [x * cos[-1] - y * sin[-1]], sin + [x * sin[-1] + y * cos[-1]]
    xx_yy = x * x + y * y
    # homogeneous forms of d^m P_l / dz^m with 1 = x² + y² + z² put in where 3DGS does
    legendre = {
        (0, 0): torch.ones_like(z), (1, 0): z, (1, 1): torch.ones_like(z),
        (2, 0): (2 * z * z - xx_yy) / 2, (2, 1): 3 * z, (2, 2): torch.full_like(z, 3.0),
        (3, 0): z * (2 * z * z - 3 * xx_yy) / 2, (3, 1): 1.5 * (4 * z * z - xx_yy),
        (3, 2): 15 * z, (3, 3): torch.full_like(z, 15.0),
    }  # fmt: skip
    out = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            k = abs(m)
            ratio = np.prod([float(i) for i in range(degree - k + 1, degree + k + 1)]) if k else 1.0
            norm = np.sqrt((2 * degree + 1) / (4 * np.pi) / ratio * (2.0 if k else 1.0))
            sign = -1.0 if k % 2 else 1.0  # Condon–Shortley
            out.append(sign * norm * legendre[degree, k] * (sin[k] if m < 0 else cos[k]))
    return torch.stack(out, -1)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_basis_vjp_is_the_derivative_of_the_polynomials(degree: int) -> None:
    """Against autograd through another form of the polynomials, and central differences of the kernel."""
    n = (degree + 1) ** 2
    rng = np.random.default_rng(degree)
    for direction in rng.normal(size=(20, 3)):
        unit = direction / np.linalg.norm(direction)
        v = rng.normal(size=16)
        actual = _basis_vjp(degree, unit.astype(np.float32), v.astype(np.float32))
        d = torch.from_numpy(unit).requires_grad_()
        (polynomials(d)[:n] * torch.from_numpy(v[:n])).sum().backward()
        assert d.grad is not None
        np.testing.assert_allclose(actual, d.grad.numpy(), atol=1e-5)
        step, differences = 1e-2, []
        for axis in np.eye(3) * step:
            values = np.zeros((2, 16), np.float32)
            _basis(degree, (unit + axis).astype(np.float32), values[0])
            _basis(degree, (unit - axis).astype(np.float32), values[1])
            differences.append((values[0].astype(float) - values[1]) @ v / (2 * step))
        np.testing.assert_allclose(actual, differences, atol=3e-3)
