"""The call: what is refused, what a CUDA tensor passes to gsplat; the dense twin against finite differences."""

import inspect
import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.fit.rasterize.oracle import random_rotations, uniform
from tests.helpers.dense import composite, project, sh_colours
from tg4mm.fit.gaussians import rotation_matrices
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.rasterize.kernels.layout import T_MIN

OPTIONS: dict[str, Any] = {
    "near_plane": 0.1,
    "far_plane": 50.0,
    "eps2d": 0.2,
    "sh_degree": 1,
    "backgrounds": torch.rand(2, 3),
}


def arguments(**changes):
    """A valid call for 5 Gaussians and 2 cameras, with changes."""
    call = {
        "means": torch.randn(5, 3),
        "quats": torch.randn(5, 4),
        "scales": torch.rand(5, 3),
        "opacities": torch.rand(5),
        "colors": torch.rand(5, 3),
        "viewmats": torch.eye(4).repeat(2, 1, 1),
        "Ks": torch.eye(3).repeat(2, 1, 1),
        "width": 8,
        "height": 6,
    }
    return call | changes


@pytest.mark.parametrize(
    ("name", "shape", "expected"),
    [
        ("means", (5, 2), "(5, 3)"),
        ("quats", (4, 4), "(5, 4)"),
        ("scales", (1, 3), "(5, 3)"),
        ("opacities", (5, 1), "(5,)"),
        ("colors", (4, 3), "(5, 'any')"),
        ("viewmats", (4, 4), "(4, 4, 4)"),
        ("Ks", (3, 3), "(2, 3, 3)"),
        ("backgrounds", (3,), "(2, 3)"),
    ],
)
def test_a_wrong_shape_is_named_with_the_right_one(name, shape, expected):
    """Shapes are exact: nothing is broadcast."""
    with pytest.raises(ValueError, match=r"expected") as caught:
        rasterization(**arguments(**{name: torch.ones(shape)}))
    assert f"{name} has shape {shape}, expected {expected}" in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sh_degree": 4, "colors": torch.ones(5, 25, 3)}, "sh_degree is 4, expected 0 to 3"),
        ({"sh_degree": 2, "colors": torch.ones(5, 4, 3)}, "colors has 4 SH coefficients, degree 2 needs 9"),
        ({"width": 0}, "image size is 0×6, expected at least 1×1"),
    ],
)
def test_a_wrong_option_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        rasterization(**arguments(**changes))


@pytest.fixture
def pretend_cuda(monkeypatch):
    """Tensors say that they lie on a GPU; nothing else changes."""
    monkeypatch.setattr(torch.Tensor, "is_cuda", property(lambda _: True), raising=False)


@pytest.mark.usefixtures("pretend_cuda")
def test_cuda_tensors_go_to_gsplat_under_its_argument_names(monkeypatch):
    """Bound to gsplat's own signature, every argument arrives as it was given; importing needs no GPU."""
    gsplat = pytest.importorskip("gsplat", reason='gsplat is not installed (pip install ".[cuda]")')
    signature = inspect.signature(gsplat.rasterization)
    calls: list[inspect.BoundArguments] = []

    def record(*args, **kwargs):
        calls.append(signature.bind(*args, **kwargs))
        return "renders", "alphas", "meta"

    monkeypatch.setattr(gsplat, "rasterization", record)
    call = arguments(colors=torch.rand(5, 4, 3), **OPTIONS)
    assert rasterization(**call) == ("renders", "alphas", "meta")
    assert len(calls) == 1
    for name, value in call.items():
        assert calls[0].arguments[name] is value, name
    extra = {k: v for k, v in calls[0].arguments.items() if k not in call}
    assert extra == {"packed": False}


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
