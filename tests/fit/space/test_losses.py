"""The photometric loss: SSIM against scikit-image's, gradients against differences, the paper's L1 as a limit."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from tg4mm.fit.space.losses import photometric_loss, ssim


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
