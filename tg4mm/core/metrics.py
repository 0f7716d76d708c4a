"""Image metrics against ground truth: PSNR, SSIM and FLIP of one rendered image.

Images are [H, W, 3] floats in 0..1, display-referred sRGB, already composited on the same background.
LPIPS needs weights from the user and lives in `tg4mm.research.evaluate.lpips`.
"""

import importlib.util

import numpy as np
from skimage.metrics import structural_similarity

from tg4mm.core.extras import install

MAX_PSNR_DB = 100.0  # equal images would be infinite, which neither averages nor fits in JSON
NO_FLIP = f"needs flip_evaluator, which comes for Python 3.11 to 3.13: {install('flip')}"
SSIM_WINDOW = 11  # pixels
SSIM_BORDER = SSIM_WINDOW // 2
_SSIM_SIGMA = 1.5  # scikit-image cuts at 3.5 σ: int(3.5 · 1.5 + 0.5) = 5 pixels each side, hence 11 × 11


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """Peak signal-to-noise ratio, dB, peak 1, over all pixels and channels; at most `MAX_PSNR_DB`.

    Raises ValueError if the shapes or the values are not those of two images of the same size.
    """
    image, truth = check_images(image, truth)
    return decibels(float(np.mean((image.astype(np.float64) - truth) ** 2)))


def decibels(mse: float) -> float:
    """PSNR of a mean squared error, dB, peak 1; at most `MAX_PSNR_DB`."""
    return min(MAX_PSNR_DB, -10.0 * float(np.log10(mse))) if mse > 0 else MAX_PSNR_DB


def ssim(image: np.ndarray, truth: np.ndarray) -> float:
    """Structural similarity (Wang et al. 2004): the mean of `ssim_map` but for its border.

    As usual the five pixels nearest the border, where the window leaves the image, are not counted.
    """
    similar = ssim_map(image, truth)
    return float(similar[SSIM_BORDER:-SSIM_BORDER, SSIM_BORDER:-SSIM_BORDER].mean())


def ssim_map(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return [H, W] structural similarity, 11×11 Gaussian window of σ 1.5, K = (0.01, 0.03), mean over channels.

    Raises ValueError as `psnr`, and for an image smaller than the window.
    """
    image, truth = check_images(image, truth)
    if min(image.shape[:2]) < SSIM_WINDOW:
        raise ValueError(
            f"image of {image.shape[1]}×{image.shape[0]} pixels is smaller than SSIM's window of 11×11"
        )
    _, similar = structural_similarity(
        truth.astype(np.float64),
        image.astype(np.float64),
        gaussian_weights=True,
        sigma=_SSIM_SIGMA,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
        full=True,
    )
    return np.asarray(similar.mean(-1))


def has_flip() -> bool:
    """Return whether the package that `flip` needs is installed."""
    return importlib.util.find_spec("flip_evaluator") is not None


def flip(image: np.ndarray, truth: np.ndarray) -> float:
    """Mean LDR-FLIP error (Andersson et al. 2020), 0 (equal) to 1, at its default of 67 pixels per degree.

    Raises ValueError as `psnr`, ModuleNotFoundError without the extra flip.
    """
    import flip_evaluator

    image, truth = check_images(image, truth)
    reference, test = (np.ascontiguousarray(i, dtype=np.float32) for i in (truth, image))
    _, mean, _ = flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False)
    return float(mean)


def check_images(image: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both images [H, W, 3]. Raises ValueError if sizes differ or values are outside 0..1."""
    image, truth = np.asarray(image), np.asarray(truth)
    if image.shape != truth.shape or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ValueError(
            f"image has shape {image.shape} and truth {truth.shape}, expected the same [H, W, 3]"
        )
    for name, array in (("image", image), ("truth", truth)):
        if not np.issubdtype(array.dtype, np.floating):
            raise ValueError(f"{name} has type {array.dtype}, expected floats in 0..1")
        low, high = float(array.min()), float(array.max())
        if not (low >= 0.0 and high <= 1.0):  # also catches NaN
            raise ValueError(f"{name} has values from {low:g} to {high:g}, expected 0..1")
    return image, truth
