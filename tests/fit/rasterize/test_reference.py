"""The dense twin: its derivatives against finite differences, its formulas against independent ones."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.fit.rasterize.oracle import random_rotations, uniform
from tg4mm.fit.rasterize.kernels.layout import T_MIN
from tg4mm.fit.rasterize.reference import composite, project, rotation_matrices, sh_colours


@pytest.fixture
def rng():
    return torch.Generator().manual_seed(0)


def geometry(rng, n):
    """means, quats, scales, viewmat [4, 4], K [3, 3] of a scene that fills an image of 6 × 5 pixels."""
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[:3, :3] = random_rotations(rng, 1)[0]
    viewmat[2, 3] = 4.0
    K = torch.tensor([[7.0, 0, 2.7], [0, 6.0, 2.9], [0, 0, 1]], dtype=torch.float64)
    quats = torch.randn(n, 4, generator=rng, dtype=torch.float64)
    return uniform(rng, n, 3, low=-0.8, high=0.8), quats, uniform(rng, n, 3, low=1.0, high=2.0), viewmat, K


def test_rotation_matrices_are_scipys(rng):
    quats = torch.randn(20, 4, generator=rng, dtype=torch.float64) * 3
    expected = Rotation.from_quat(quats.numpy()[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(rotation_matrices(quats).numpy(), expected, atol=1e-14)


def test_sh_colours_are_clamped_at_zero_without_gradient():
    sh = torch.full((1, 1, 3), -3.0, dtype=torch.float64, requires_grad=True)
    colour = sh_colours(sh, torch.ones(1, 3, dtype=torch.float64))
    colour.sum().backward()
    assert not colour.any()
    assert not sh.grad.any()


def test_spherical_harmonics_are_orthonormal():
    """∫ Y_i Y_j over the sphere is δ_ij, by a quadrature that is exact for these polynomials."""
    z, weight = np.polynomial.legendre.leggauss(8)
    phi = 2 * np.pi * np.arange(16) / 16
    r = np.sqrt(1 - z**2)
    directions = np.stack([np.outer(r, np.cos(phi)), np.outer(r, np.sin(phi)), np.outer(z, np.ones(16))], -1)
    n = directions.reshape(-1, 3)
    unit = torch.eye(16, dtype=torch.float64)[:, :, None].repeat(1, 1, 3) * 0.1
    values = np.stack([(sh_colours(u[None].expand(len(n), -1, -1), torch.from_numpy(n))[:, 0] - 0.5) / 0.1
                       for u in unit])  # fmt: skip
    weights = (np.repeat(weight, 16) * 2 * np.pi / 16)[None]
    np.testing.assert_allclose((values * weights) @ values.T, np.eye(16), atol=1e-12)


def test_projected_mean_and_depth_are_the_pinhole_cameras(rng):
    means, quats, scales, viewmat, K = geometry(rng, 5)
    uv, _, depth = project(means, quats, scales, viewmat, K, 6, 5, 0.3)
    homogeneous = (viewmat @ torch.cat([means, torch.ones(5, 1, dtype=torch.float64)], 1).T)[:3]
    pixels = K @ homogeneous
    assert torch.allclose(uv, (pixels[:2] / pixels[2]).T)
    assert torch.allclose(depth, homogeneous[2])


def test_projected_covariance_is_that_of_projected_samples(rng):
    """EWA is the first order: exact in the limit of a small Gaussian."""
    means, quats, scales, viewmat, K = geometry(rng, 3)
    scales = scales * 1e-3
    uv, cov, _ = project(means, quats, scales, viewmat, K, 600, 500, 0.0)
    normal = torch.randn(200_000, 3, generator=rng, dtype=torch.float64)
    for i in range(3):
        samples = means[i] + (normal * scales[i]) @ rotation_matrices(quats[i : i + 1])[0].T
        ones = torch.ones(len(samples), 1, dtype=torch.float64)
        cam = (viewmat @ torch.cat([samples, ones], 1).T)[:3]
        pixels = (K @ cam)[:2] / cam[2] - uv[i][:, None]
        assert torch.allclose(
            pixels @ pixels.T / len(samples), cov[i], rtol=0.02, atol=0.02 * cov[i].max().item()
        )


def test_composite_is_equation_3_term_by_term(rng):
    """C = Σ c_i α_i Π_{j<i} (1 - α_j), stopped before the light falls to T_MIN, as two plain loops."""
    alphas = uniform(rng, 12, 60, low=0.0, high=0.9)  # about half of the pixels are stopped
    features = uniform(rng, 12, 2)
    colour, transmittance = composite(alphas, features)
    stopped = 0
    for p in range(60):
        light, total = 1.0, torch.zeros(2, dtype=torch.float64)
        for i in range(12):
            behind = light * (1 - alphas[i, p].item())
            if behind <= T_MIN:
                stopped += 1
                break
            total += light * alphas[i, p] * features[i]
            light = behind
        assert torch.allclose(colour[p], total)
        assert math.isclose(transmittance[p].item(), light)
    assert 0 < stopped < 60
