"""Twenty random Gaussians, and a random motion of them."""

import numpy as np
import torch

from tg4mm.core.magnification import Magnification
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion

N, FPS = 20, 30.0


FREQS = np.array([2.0, 5.0, 8.0])


def gaussians(dtype: torch.dtype = torch.float32) -> Gaussians:
    g = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.randn(*shape, generator=g, dtype=torch.float64).to(dtype)  # noqa: E731
    return Gaussians(draw(N, 3), draw(N, 4), draw(N, 3).exp(), draw(N).sigmoid(), draw(N, 4, 3))


def motion(freqs: np.ndarray = FREQS, size: float = 0.1, seed: int = 1) -> ModalMotion:
    rng = np.random.default_rng(seed)
    real, imaginary = size * rng.normal(size=(2, 2, len(freqs), N, 3))
    displacement, rotation = (real + 1j * imaginary).astype(np.complex64)
    return ModalMotion.of_phasors(freqs, displacement, rotation, FPS, 30)


def alphas(motion, alpha, band=None):
    """[K]: α of each mode, magnified in one band, or everywhere."""
    return Magnification.of(alpha, *([] if band is None else [band])).ideal(motion.freqs_hz)
