"""One training view: the picture over white, and the error's shares, against the dense twin in float64."""

import pytest
import torch

from tests.fit.rasterize.oracle import assert_close, make_scene, thresholds
from tests.helpers.dense import rasterize_dense
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space.view import render_view

SCENE = make_scene(0)
SIZE = (SCENE.width, SCENE.height)


def gaussians():
    tensors = [
        t.detach().float() for t in (SCENE.means, SCENE.quats, SCENE.scales, SCENE.opacities, SCENE.colors)
    ]
    return Gaussians(*(t.requires_grad_() for t in tensors))


def dense(features, use_sh):
    return rasterize_dense(
        SCENE.means, SCENE.quats, SCENE.scales, SCENE.opacities, features, SCENE.viewmats[0], SCENE.Ks[0],
        *SIZE, use_sh=use_sh,
    )  # fmt: skip


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_the_picture_stands_over_white(degree):
    safe = thresholds(SCENE).safe[..., None]
    view = render_view(gaussians(), SCENE.viewmats[0].float(), SCENE.Ks[0].float(), SIZE, degree)
    image, alpha = dense(SCENE.colors[:, : (degree + 1) ** 2], True)
    assert_close("picture", view.rgb * safe, (image + 1 - alpha[..., None]) * safe, 1e-4)
    assert (view.carrier == 0).all()


def test_shares_are_blending_weight_times_error():
    safe = thresholds(SCENE).safe
    error = torch.rand(SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(1)) * safe
    g = gaussians()
    view = render_view(g, SCENE.viewmats[0].float(), SCENE.Ks[0].float(), SIZE, 3)
    with pytest.raises(AssertionError, match="before backward"):
        view.shares()
    (view.rgb.mean() + (view.carrier * error).sum()).backward()
    channel = torch.zeros(len(SCENE.means), 1, dtype=torch.float64, requires_grad=True)
    image, _ = dense(channel, False)
    (expected,) = torch.autograd.grad((image[..., 0] * error).sum(), channel)
    assert (expected > 0).sum() > 20
    assert_close("shares", view.shares(), expected[:, 0], 1e-4)
