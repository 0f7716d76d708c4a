"""The photometric loss: SSIM against scikit-image's, gradients against differences, the paper's L1 as a limit.

Gains of pictures: what fits is found, ratios alone count, and pictures spoilt by known gains give these back.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from tg4mm.fit.space import SpaceConfig
from tg4mm.fit.space.losses import photometric_loss, ssim
from tg4mm.run.stages import train_space
from tg4mm.show.render.image import render_image


def pair(height, width, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    a = 0.5 + 0.4 * np.sin(x[..., None] / [3.0, 4.0, 5.0] + y[..., None] / 6.0)
    return torch.tensor(a), torch.tensor((a + noise * rng.normal(size=a.shape)).clip(0, 1))


def skimage_ssim(a, b):
    """The map [H, W, 3]: Gaussian window 11 × 11, σ 1.5, population covariance; mirrored border."""
    _, full = structural_similarity(
        a.numpy(), b.numpy(), data_range=1.0, channel_axis=-1, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    return full


def test_ssim_is_that_of_scikit_image_of_the_picture_on_black():
    """Ours pads with zeros where scikit-image mirrors: on a black ground both see the same, border included."""
    a, b = pair(24, 31)
    on_black = [torch.nn.functional.pad(x, (0, 0, 10, 10, 10, 10)) for x in (a, b)]
    expected = skimage_ssim(*on_black)[10:-10, 10:-10]
    assert ssim(a, b).item() == pytest.approx(expected.mean(), abs=1e-12)
    # what mirroring would give is another number, so the border is part of the comparison
    assert abs(skimage_ssim(a, b).mean() - expected.mean()) > 0.01


def test_the_parts_are_weighted_as_written():
    a, b = pair(16, 16)
    l1, mse = np.abs(a.numpy() - b.numpy()).mean(), ((a.numpy() - b.numpy()) ** 2).mean()
    expected = 0.8 * (l1 + 10 * mse) + 0.2 * (1 - ssim(a, b).item()) / 2
    assert photometric_loss(a, b, 10.0, 0.2).item() == pytest.approx(expected, rel=1e-12)


def test_known_gains_are_found(views, points, new_run):
    """A quarter at most of 10 % is left, and the Gaussians are nearer to the pictures without gains.

    After 1500 iterations .17 or .27 is left by the order of sums alone, after 2500 .19 to .21.
    """
    logs = np.random.default_rng(0).normal(0, 0.1, (len(views.rgb), 3))
    given = np.exp(logs - logs.mean(0))
    # a grey floor in place of white, which would be clipped
    clean = 0.7 * views.rgb
    spoilt = replace(views, rgb=(clean * given[:, None, None]).astype(np.float32))
    error = {}
    for gains in (True, False):
        run = new_run()
        config = SpaceConfig(iterations=2500, max_gaussians=1500, gains=gains)
        gaussians = train_space(run, spoilt, points, config)
        cameras = zip(views.viewmats, views.Ks, strict=True)
        pictures = np.stack([render_image(gaussians, m, K, *views.size) for m, K in cameras])
        error[gains] = float(np.sqrt(np.mean((pictures - clean) ** 2)))
        assert ("gains" in run.log()["space"]) == gains
        if gains:
            off = np.log(run.log()["space"]["gains"]) - np.log(given)
            assert off.std() < 0.25 * np.log(given).std()
    assert error[True] < error[False]


@pytest.mark.parametrize("gains", [True, False])
def test_torch_and_the_fused_iteration_agree_on_gains(gains):
    from tests.helpers.space_fused import SCENE, parameters, views_of
    from tests.helpers.space_parameters import EXTENT
    from tg4mm.fit.space import train as stage
    from tg4mm.fit.space.fused import FusedAdam
    from tg4mm.fit.space.parameters import ParameterAdam

    start = torch.tensor([[0.8, 1.0, 1.2], [1.0, 1.1, 1.0], [1.25, 1 / 1.1, 1 / 1.2]])
    found = []
    for kind in (FusedAdam, ParameterAdam):
        cameras = stage._Views(views_of(), SpaceConfig(dssim=0.2), "cpu")
        generator, error = torch.Generator(), torch.zeros(len(SCENE.means))
        fit = stage._Fit(kind(parameters(), EXTENT), error, torch.zeros(()), generator, generator)
        fit.gains = start if gains else None
        cameras.iterate(fit, 0, 3, 0.0)
        found.append((fit.adam.moments()["sh0.m"], fit.gains))
    torch.testing.assert_close(found[0][0], found[1][0], rtol=1e-3, atol=1e-6)
    if gains:
        torch.testing.assert_close(found[0][1], found[1][1], rtol=1e-5, atol=1e-6)
        assert not torch.equal(found[0][1], start)
