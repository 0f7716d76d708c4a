"""Spherical harmonics of the kernels and their derivatives, against other forms of the polynomials."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numba import njit

from tg4mm.fit.rasterize.kernels.sh import basis, basis_vjp
from tg4mm.fit.rasterize.reference import sh_colours
from tg4mm.fit.rasterize.simd.memory import load, store
from tg4mm.fit.rasterize.simd.rows import store_rows
from tg4mm.fit.rasterize.simd.vector import LANES


@njit
def _basis(degree: int, d: np.ndarray, out: np.ndarray) -> None:
    store_rows(out, 0, basis(degree, load(d, 0), load(d, LANES), load(d, 2 * LANES)))


@njit
def _basis_vjp(degree: int, d: np.ndarray, v: np.ndarray, out: np.ndarray) -> None:
    of = (
        load(v, 0), load(v, 16), load(v, 32), load(v, 48), load(v, 64), load(v, 80), load(v, 96), load(v, 112),
        load(v, 128), load(v, 144), load(v, 160), load(v, 176), load(v, 192), load(v, 208), load(v, 224), load(v, 240),
    )  # fmt: skip
    x, y, z = basis_vjp(degree, load(d, 0), load(d, LANES), load(d, 2 * LANES), of)
    store(out, 0, x)
    store(out, LANES, y)
    store(out, 2 * LANES, z)


def values(degree: int, directions: np.ndarray) -> np.ndarray:
    """[16 directions, 16]"""
    out = np.full((LANES, 16), 9.0, np.float32)
    _basis(degree, np.ascontiguousarray(directions.T, np.float32).ravel(), out.ravel())
    return out


def directions(seed: int) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(LANES, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_basis_is_the_twins(degree: int) -> None:
    n, d = (degree + 1) ** 2, directions(degree)
    out = values(degree, d)
    coefficients = 0.1 * torch.eye(n, dtype=torch.float64)[:, :, None].repeat(1, 1, 3)
    for row, unit in zip(out, d, strict=True):
        twin = (sh_colours(coefficients, torch.from_numpy(unit).expand(n, 3))[:, 0] - 0.5) / 0.1
        np.testing.assert_allclose(row[:n], twin.numpy(), atol=1e-6)
    assert (out[:, n:] == 0).all()


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
    n, unit = (degree + 1) ** 2, directions(degree)
    v, out = np.random.default_rng(degree).normal(size=(16, LANES)), np.empty((3, LANES), np.float32)
    _basis_vjp(degree, np.float32(unit.T).ravel(), np.float32(v).ravel(), out.ravel())
    d = torch.from_numpy(unit).requires_grad_()
    (polynomials(d)[:, :n] * torch.from_numpy(v[:n].T)).sum().backward()
    assert d.grad is not None
    np.testing.assert_allclose(out.T, d.grad.numpy(), atol=1e-5)
    step = 1e-2
    rises = [
        values(degree, unit + axis).astype(float) - values(degree, unit - axis) for axis in np.eye(3) * step
    ]
    differences = [(rise * v.T).sum(1) / (2 * step) for rise in rises]
    np.testing.assert_allclose(out, differences, atol=3e-3)
