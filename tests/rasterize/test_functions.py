"""The kernels' scalar functions: the exponential, spherical harmonics and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numba import njit

from tg4mm.rasterize.kernels.sh import basis, basis_vjp
from tg4mm.rasterize.kernels.simd import exp_neg
from tg4mm.rasterize.reference import sh_colours


@njit
def _exp_neg(x: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(x)):
        out[i] = exp_neg(x[i])


@njit
def _basis(degree: int, d: np.ndarray, out: np.ndarray) -> None:
    basis(degree, d[0], d[1], d[2], out)


@njit
def _basis_vjp(degree: int, d: np.ndarray, v: np.ndarray) -> tuple[float, float, float]:
    return basis_vjp(degree, d[0], d[1], d[2], v)


@pytest.mark.parametrize(("low", "high", "bound"), [(0.0, 6.0, 7e-7), (0.0, 80.0, 4e-6)])
def test_exp_neg_is_as_accurate_as_it_says(low: float, high: float, bound: float) -> None:
    x = np.linspace(low, high, 400_001, dtype=np.float32)
    out = np.empty_like(x)
    _exp_neg(x, out)
    relative = np.abs(out.astype(np.float64) / np.exp(-x.astype(np.float64)) - 1)
    assert relative.max() < bound


def test_exp_neg_of_zero_is_exactly_one() -> None:
    out = np.empty(1, np.float32)
    _exp_neg(np.zeros(1, np.float32), out)
    assert out[0] == 1.0


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
