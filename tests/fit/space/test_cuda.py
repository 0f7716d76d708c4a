"""The space stage as it runs on a GPU. Without one: the same code with gsplat's two calls made by our CPU path."""

import sys
import types

import pytest
import torch

from tests.fit.rasterize.oracle import assert_close, make_scene
from tests.helpers.cuda import needs_cuda
from tests.helpers.space_cuda import spherical_harmonics
from tests.helpers.space_train import psnr_of_test_views
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space import SpaceConfig
from tg4mm.fit.space import train as stage
from tg4mm.fit.space.targets import SceneUnit
from tg4mm.fit.space.train import pictures_digest
from tg4mm.fit.space.view import _render_cuda, render_view
from tg4mm.run.stages import train_space

SCENE = make_scene(0)
SIZE = (SCENE.width, SCENE.height)
SHORT = SpaceConfig(iterations=36, max_gaussians=500, init_points=300)


@pytest.fixture
def gsplat_on_cpu(monkeypatch):
    module = types.ModuleType("gsplat")
    module.spherical_harmonics = spherical_harmonics
    monkeypatch.setitem(sys.modules, "gsplat", module)


def outcome(render, degree, device="cpu"):
    """Picture, carrier, shares and gradients of a loss on all of them."""
    tensors = [getattr(SCENE, k) for k in ("means", "quats", "scales", "opacities", "colors")]
    leaves = [t.detach().to(device, torch.float32).requires_grad_() for t in tensors]
    viewmat, K = SCENE.viewmats[0].to(device).float(), SCENE.Ks[0].to(device).float()
    view = render(Gaussians(*leaves), viewmat, K, SIZE, degree)
    error = torch.rand(SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(1)).to(device)
    (view.rgb.square().mean() + (view.carrier * error).sum()).backward()
    found = {"rgb": view.rgb, "carrier": view.carrier, "shares": view.shares()}
    names = ("means", "quats", "scales", "opacities", "sh")
    grads = {f"gradient by {n}": leaf.grad for n, leaf in zip(names, leaves, strict=True)}
    assert all(g is not None for g in grads.values())
    return {k: v.detach().cpu() for k, v in (found | grads).items() if v is not None}


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_a_view_made_for_gsplat_is_the_cpus(degree, gsplat_on_cpu):
    expected = outcome(render_view, degree)
    assert expected["shares"].max() > 0
    for name, value in outcome(_render_cuda, degree).items():
        assert_close(name, value, expected[name], 1e-4)


@needs_cuda
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_view_on_cuda_is_the_cpus(degree):
    expected = outcome(render_view, degree)
    for name, value in outcome(render_view, degree, "cuda").items():
        assert_close(name, value, expected[name], 5e-3)


def test_a_checkpoint_with_a_second_generator_comes_back(views, points, new_run):
    """What a GPU's run leaves is taken up on the CPU; the state of the device's generator goes along."""
    config, unit = stage.resolved(SHORT, views), SceneUnit.of(views, points)
    own = unit.views(views)
    fit, extent, _ = stage._started(own, unit.points(points), config, "cpu")
    fit.draws = torch.Generator().manual_seed(5)
    assert "draws" in fit.tensors()
    run = new_run()
    run.save_checkpoint("space", *fit.checkpoint(extent, pictures_digest(own)))
    checkpoint = run.load_checkpoint("space")
    assert checkpoint is not None
    back, _ = stage._restored(checkpoint, views, "cpu")
    assert back.draws is back.generator
    assert set(back.adam.parameters) == set(fit.adam.parameters)
    assert len(train_space(run, views, points, SHORT)) > 0


@needs_cuda
def test_training_on_cuda_is_as_good_as_on_the_cpu(views, points, data, new_run):
    config = SpaceConfig(iterations=500, max_gaussians=1500, dssim=0.2)
    run = new_run()
    here = psnr_of_test_views(train_space(new_run(), views, points, config, "cpu"), data)
    there = psnr_of_test_views(train_space(run, views, points, config, "cuda"), data)
    assert abs(there - here) < 0.5
    assert run.log()["space"]["peak_gpu_memory_mib"] > 0
