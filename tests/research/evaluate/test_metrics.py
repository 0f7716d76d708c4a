"""PSNR, SSIM and FLIP against hand computation and the reference formulas."""

import flip_evaluator
import numpy as np
import pytest
from scipy.ndimage import correlate

from tg4mm.core.metrics import MAX_PSNR_DB, flip, psnr, ssim


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    truth = rng.random((40, 33, 3)).astype(np.float32)
    return np.clip(truth + 0.1 * rng.standard_normal(truth.shape), 0, 1).astype(np.float32), truth


def plain_ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Wang et al.'s formula with an explicit 11×11 window, one channel at a time, window inside the image."""
    offsets = np.arange(-5, 6)
    line = np.exp(-(offsets**2) / (2 * 1.5**2))
    window = np.outer(line, line) / line.sum() ** 2

    def mean(x: np.ndarray) -> np.ndarray:
        return correlate(x, window)[5:-5, 5:-5]

    values = []
    for x, y in zip(np.moveaxis(a, -1, 0).astype(float), np.moveaxis(b, -1, 0).astype(float), strict=True):
        mx, my = mean(x), mean(y)
        vx, vy, cov = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
        values.append(
            ((2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))).mean()
        )
    return float(np.mean(values))


def test_psnr_of_a_known_error() -> None:
    truth = np.full((8, 8, 3), 0.5)
    image = truth.copy()
    image[:4] += 0.1  # half of the pixels: mse 0.005
    assert psnr(image, truth) == pytest.approx(10 * np.log10(1 / 0.005))


def test_psnr_of_equal_images_is_the_cap() -> None:
    truth = np.full((8, 8, 3), 0.5)
    assert psnr(truth, truth) == MAX_PSNR_DB
    assert psnr(truth + 1e-9, truth) == MAX_PSNR_DB


def test_ssim_is_the_formula_with_an_11_by_11_window(pair) -> None:
    assert ssim(*pair) == pytest.approx(plain_ssim(*pair), abs=1e-12)
    assert ssim(pair[1], pair[1]) == pytest.approx(1.0, abs=1e-12)


def test_ssim_sees_no_further_than_five_pixels() -> None:
    """A changed pixel in the corner lies in the window of exactly one counted pixel, (5, 5)."""
    truth = np.full((16, 16, 3), 0.5)
    image = truth.copy()
    image[0, 0] = 1.0
    reached = ssim(image, truth)
    assert reached < 1.0
    assert reached == pytest.approx(plain_ssim(image, truth), abs=1e-12)
    wider = np.pad(truth, ((1, 0), (1, 0), (0, 0)), constant_values=0.5)
    wider[0, 0] = 1.0
    np.testing.assert_allclose(
        (1 - ssim(wider, np.full_like(wider, 0.5))) * 49, (1 - reached) * 36, rtol=1e-9
    )


def test_flip_is_the_evaluators_mean_and_leaves_its_input_alone(pair) -> None:
    image, truth = pair
    before = image.copy(), truth.copy()
    errors, mean, _ = flip_evaluator.evaluate(truth, image, "LDR", applyMagma=False)
    assert flip(image, truth) == pytest.approx(mean)
    assert flip(image, truth) == pytest.approx(float(errors.mean()), rel=1e-5)
    assert 0.01 < mean < 1
    assert flip(truth, truth) == 0.0
    for now, then in zip((image, truth), before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_flip_of_black_against_white_is_nearly_one() -> None:
    black = np.zeros((32, 32, 3), np.float32)
    assert flip(black, 1 - black) > 0.9


def test_a_view_of_a_larger_array_scores_as_its_copy(pair) -> None:
    image, truth = pair
    for metric in (psnr, ssim, flip):
        assert metric(image[::2, ::2], truth[::2, ::2]) == metric(
            image[::2, ::2].copy(), truth[::2, ::2].copy()
        )


@pytest.mark.parametrize("metric", [psnr, ssim, flip])
def test_shapes_and_values_are_checked_and_shown(metric, pair) -> None:
    image, truth = pair
    with pytest.raises(ValueError, match=r"\(40, 33, 3\) and truth \(39, 33, 3\)"):
        metric(image, truth[1:])
    with pytest.raises(ValueError, match=r"\(40, 33\)"):
        metric(image[..., 0], truth[..., 0])
    with pytest.raises(ValueError, match=r"image has values from .* to 2, expected 0..1"):
        metric(np.where(image > 0.5, 2.0, image), truth)
    with pytest.raises(ValueError, match="nan"):
        metric(image, np.full_like(truth, np.nan))
    with pytest.raises(ValueError, match="uint8"):
        metric(np.zeros((12, 12, 3), np.uint8), np.zeros((12, 12, 3), np.uint8))


def test_ssim_names_an_image_smaller_than_its_window() -> None:
    small = np.zeros((10, 20, 3))
    with pytest.raises(ValueError, match="20×10 pixels"):
        ssim(small, small)
