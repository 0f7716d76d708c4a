"""gsplat's own pure-torch reference, which needs no GPU, against our twin and kernels.

Only projection and spherical harmonics: its compositing calls a CUDA kernel and nerfacc.
"""

import types

import pytest
import torch

from tests.fit.rasterize.oracle import Scene, make_scene, render, thresholds
from tg4mm.fit.rasterize.kernels.layout import CA, CC, DEPTH, MX, MY, POWER
from tg4mm.fit.rasterize.reference import project, sh_colours


@pytest.fixture(scope="module")
def peer() -> types.ModuleType:
    return pytest.importorskip(
        "gsplat.cuda._torch_impl", reason="gsplat's torch reference cannot be imported"
    )


@pytest.fixture(scope="module")
def scene() -> Scene:
    scene = make_scene(5, spread=3.0, distance=3.0, n=200, scale=(0.05, 0.8))
    assert thresholds(scene).n_clamped >= 10
    return scene


@pytest.fixture(scope="module")
def projected(peer: types.ModuleType, scene: Scene) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Means [N, 2], conics [N, 3] and depths [N] as gsplat has them, in float64."""
    covars, _ = peer._quat_scale_to_covar_preci(scene.quats, scene.scales)
    _, means2d, depths, conics, _ = peer._fully_fused_projection(
        scene.means, covars, scene.viewmats, scene.Ks, scene.width, scene.height
    )
    return means2d[0], conics[0], depths[0]


def test_the_twin_projects_as_gsplat(projected: tuple[torch.Tensor, ...], scene: Scene) -> None:
    means2d, conics, depths = projected
    uv, cov, depth = project(
        scene.means, scene.quats, scene.scales, scene.viewmats[0], scene.Ks[0], scene.width, scene.height, 0.3
    )
    inverse = torch.linalg.inv(cov)
    front = depth > 0.01
    ours = torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], 1)
    assert torch.allclose(depth, depths, rtol=1e-12)
    assert torch.allclose(uv[front], means2d[front], rtol=1e-10)
    assert torch.allclose(ours[front], conics[front], rtol=1e-8, atol=1e-12)


def test_the_kernels_project_as_gsplat(projected: tuple[torch.Tensor, ...], scene: Scene) -> None:
    means2d, conics, depths = projected
    _, _, meta = render([t.detach() for t in scene.tensors(torch.float32)], scene, 3)
    splats = torch.from_numpy(meta["projected"][0].splats).double()
    seen = splats[:, POWER] > 0
    assert seen.sum() > 50
    splats = splats[seen]
    assert torch.allclose(splats[:, DEPTH], depths[seen], rtol=1e-6)
    assert torch.allclose(splats[:, MX : MY + 1], means2d[seen], rtol=1e-5, atol=1e-4)
    scale = conics[seen].abs().amax(1, keepdim=True)
    assert ((splats[:, CA : CC + 1] - conics[seen]).abs() / scale).max() < 1e-4


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spherical_harmonics_are_gsplats(peer: types.ModuleType, degree: int) -> None:
    rng = torch.Generator().manual_seed(degree)
    sh = torch.randn(50, (degree + 1) ** 2, 3, generator=rng, dtype=torch.float64)
    directions = torch.randn(50, 3, generator=rng, dtype=torch.float64) * 3
    theirs = (peer._spherical_harmonics(degree, directions, sh) + 0.5).clamp_min(0)
    # gsplat writes some constants with fewer digits
    assert torch.allclose(sh_colours(sh, directions), theirs, atol=1e-6)
