"""The CPU kernels against the dense float64 twin: values and gradients, on scenes that go to extremes."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from tests.fit.rasterize.oracle import (
    NAMES,
    TOLERANCE,
    Scene,
    Thresholds,
    assert_close,
    check,
    make_scene,
    render,
    thresholds,
    twin,
    uniform,
    with_channels,
)
from tg4mm.fit.rasterize import api
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, ALPHA_MIN, POWER


def always(_):
    return True


# name: scene, what must be true of it for the case to test what it says, tolerance
SCENES: dict[str, tuple[Scene, Callable[[Thresholds], bool], float]] = {
    "ordinary": (make_scene(0), always, TOLERANCE),
    "large": (make_scene(1, scale=(0.5, 3.0)), always, TOLERANCE),
    "smaller than a pixel": (make_scene(2, n=150, scale=(1e-5, 3e-3)), lambda t: t.aspect < 1.2, TOLERANCE),
    "across the edges": (make_scene(3, spread=4.0, distance=7.0, n=80), always, TOLERANCE),
    "behind and around the camera": (make_scene(4, spread=2.0, distance=0.3, n=80), always, TOLERANCE),
    "beyond the field of view": (
        make_scene(5, spread=3.0, distance=2.0, n=80, scale=(0.3, 1.0)),
        lambda t: t.n_clamped >= 10,
        TOLERANCE,
    ),
    "nearly opaque": (
        make_scene(6, opacity=(0.9995, 1.0), scale=(0.05, 0.5)),
        lambda t: t.largest > ALPHA_MAX,
        TOLERANCE,
    ),
    "very faint": (make_scene(8, opacity=(0.003, 0.02), n=80), lambda t: t.largest < 0.02, TOLERANCE),
    "light spent": (
        make_scene(19, n=250, spread=0.3, scale=(0.1, 0.4), opacity=(0.3, 0.95)),
        lambda t: t.n_stopped > 200,
        TOLERANCE,
    ),
    # A thin ellipse's exponent is a difference of large terms: its error grows with the square of its length
    # over its width. Float32 leaves 1e-4 of the value and 1e-3 of the gradients at 100 : 1.
    "needles": (make_scene(10, scale=(1e-4, 1.0), n=60), lambda t: t.aspect > 15, 3e-4),
    "sharp needles": (
        replace(make_scene(11, n=12), scales=torch.tensor([[3.0, 1e-3, 1e-3]]).double().repeat(12, 1)),
        lambda t: t.aspect > 50,
        4e-3,
    ),
    "one Gaussian": (make_scene(12, n=1, spread=0.1, scale=(0.1, 0.3)), always, TOLERANCE),
}


@pytest.mark.parametrize("name", SCENES)
def test_values_and_gradients_equal_the_twins(name):
    scene, premise, tolerance = SCENES[name]
    assert premise(thresholds(scene)), f"the scene is not {name}"
    check(scene, margin=1e-4 if tolerance == TOLERANCE else 2e-3, tolerance=tolerance)


@pytest.mark.parametrize("length", [10.0, 100.0, 1000.0])
def test_a_needle_longer_than_any_image_is_drawn(length):
    """Its covariance has a condition up to 1e10 and cancels in float32 unless its determinant is a sum."""
    scene = with_channels(make_scene(13, n=1, spread=0.1), 1)
    scene = replace(
        scene,
        scales=torch.tensor([[length, 1e-3, 1e-3]]).double(),
        opacities=torch.tensor([0.9]).double(),
        viewmats=torch.eye(4, dtype=torch.float64)[None],
        means=torch.tensor([[0.0, 0.0, 3.0]]).double(),
        quats=torch.tensor([[1.0, 0.3, -0.2, 0.5]]).float().double(),
    )
    safe = thresholds(scene, margin=2e-3).safe[..., None]
    expected = twin(scene.tensors(), scene, None, None)[0][0].detach() * safe
    assert (expected.abs() > 0.1).sum() > 30
    assert_close("image", render(scene.tensors(torch.float32), scene)[0][0] * safe, expected, 1e-3)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_degree_of_spherical_harmonics(degree):
    """Coefficients above the degree are there and must be left alone."""
    check(make_scene(30 + degree), sh_degree=degree)


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 7])
def test_any_number_of_plain_channels(channels):
    """More than one pass takes, too, and negative values: only spherical harmonics are clamped."""
    rng = torch.Generator().manual_seed(channels)
    scene = with_channels(make_scene(40 + channels), channels)
    check(scene, sh_degree=None, backgrounds=uniform(rng, 1, channels).float().double())


@pytest.mark.parametrize("sh_degree", [None, 3])
def test_several_cameras_with_their_backgrounds(sh_degree):
    scene = make_scene(50, cameras=3)
    if sh_degree is None:
        scene = with_channels(scene, 3)
    backgrounds = uniform(torch.Generator().manual_seed(1), 3, 3).float().double()
    check(scene, sh_degree=sh_degree, backgrounds=backgrounds)


def test_nothing_visible_gives_an_empty_image_and_no_gradient():
    scene = make_scene(61, distance=-9.0)  # all of it behind the camera
    tensors = scene.tensors(torch.float32)
    image, alpha, meta = render(tensors, scene, 3)
    (image.sum() + alpha.sum()).backward()
    assert meta["projected"][0].bins.n_visible == 0
    assert not image.any()
    assert not alpha.any()
    for name, tensor in zip(NAMES, tensors, strict=True):
        assert tensor.grad is not None, name
        assert not tensor.grad.any(), name


def test_near_and_far_planes_and_faintness_cull():
    """A Gaussian outside the planes, or nowhere above 1/255, is as good as not there."""
    scene = make_scene(62, n=4, scale=(0.2, 0.3))
    means = torch.tensor([[0.0, 0, 2], [0, 0, 3], [0, 0, 5], [0, 0, 4]])
    opacities = torch.tensor([0.9, 0.8, 0.9, 0.9 * ALPHA_MIN])
    _, quats, scales, _, colors = (a.detach() for a in scene.tensors(torch.float32))

    def image(keep, **planes):
        parts = [a[keep] for a in (means, quats, scales, opacities, colors)]
        return render(parts, replace(scene, viewmats=torch.eye(4)[None]), 3, **planes)[0]

    assert torch.equal(image([0, 1, 2, 3], near_plane=2.5, far_plane=4.5), image([1]))
    assert image([1]).abs().max() > 0.1


def test_inputs_of_other_types_and_strides():
    """float64 and transposed storage are taken as they are, and not written to; gradients come in kind."""
    scene = make_scene(63)
    wide = [a.detach().transpose(0, -1).contiguous().transpose(0, -1) for a in scene.tensors()]
    before = [a.clone() for a in wide]
    wide = [a.requires_grad_() for a in wide]
    narrow = scene.tensors(torch.float32)
    images = []
    for t in (wide, narrow):
        image, _, _ = render(t, scene, 3)
        image.square().sum().backward()
        images.append(image)
    assert torch.equal(images[0].float(), images[1])
    for name, a, b, original in zip(NAMES, wide, narrow, before, strict=True):
        assert a.grad is not None, name
        assert b.grad is not None, name
        assert a.grad.dtype == torch.float64, name
        assert torch.equal(a.grad.float(), b.grad), name
        assert torch.equal(a.detach(), original), name


@pytest.mark.parametrize("column", ["means", "quats", "scales", "opacities"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e30, 0.0])
def test_a_spoilt_gaussian_does_not_spoil_the_others(column, value):
    """A diverged parameter costs its own Gaussian, not the image; the others' gradients stay finite."""
    scene = make_scene(64, n=10)
    tensors = scene.tensors(torch.float32)
    with torch.no_grad():
        tensors[NAMES.index(column)][3] = value
    image, alpha, meta = render(tensors, scene, 3)
    (image.sum() + alpha.sum()).backward()
    assert torch.isfinite(image).all()
    others = [i for i in range(10) if i != 3]
    assert (meta["projected"][0].splats[others, POWER] > 0).sum() > 5
    for name, tensor in zip(NAMES, tensors, strict=True):
        assert tensor.grad is not None, name
        assert torch.isfinite(tensor.grad[others]).all(), name


# The comparison must be able to fail.


@pytest.mark.parametrize("kernel", ["gather_sums", "blend_backward", "project_backward"])
def test_the_comparison_refuses_a_kernel_that_is_slightly_off(kernel, monkeypatch):
    """Each backward kernel in turn returns one of its arrays 0.1 % too large."""
    real = getattr(api, kernel)
    output = {"gather_sums": 5, "blend_backward": 9, "project_backward": 11}[kernel]

    def off(*args, **kwargs):
        real(*args, **kwargs)
        array = args[output]
        array *= 1.001

    monkeypatch.setattr(api, kernel, off)
    with pytest.raises(AssertionError, match="gradient by"):
        check(make_scene(0))
