"""Random changes of colour of the twenty Gaussians of `motion_animate`."""

import numpy as np

from tg4mm.fit.motion.modes import AppearanceModes

N = 20  # of `gaussians`


def change_of(n: int, changes: int = 1, tilts: bool = True, seed: int = 0) -> np.ndarray:
    size = (changes, n, 4 if tilts else 1, 3)
    return np.random.default_rng(seed).normal(size=size).astype(np.float32)


def appearance(size: float = 1e-3, count: int = 4, modes: int = 3) -> AppearanceModes:
    rng = np.random.default_rng(5)
    series = rng.normal(size=(modes, 2)) + 1j * rng.normal(size=(modes, 2))
    return AppearanceModes(size * change_of(N, 2, count == 4, seed=6), series)
