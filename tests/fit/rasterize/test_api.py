"""The call itself: what is refused, and what a CUDA tensor passes on to gsplat."""

import inspect
from typing import Any

import pytest
import torch

from tg4mm.fit.rasterize import rasterization


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
        ({"render_mode": "RGBD"}, r"render_mode is 'RGBD', expected one of RGB, D, ED, RGB\+D, RGB\+ED"),
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


OPTIONS: dict[str, Any] = {
    "near_plane": 0.1,
    "far_plane": 50.0,
    "eps2d": 0.2,
    "sh_degree": 1,
    "backgrounds": torch.rand(2, 3),
    "render_mode": "RGB+ED",
}


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
