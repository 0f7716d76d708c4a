"""Random pictures of several cameras, and their components over time without nuisance."""

import numpy as np

from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.nuisance.fixed_cameras import picture_sums
from tg4mm.fit.motion.nuisance.projection import Nuisance
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.targets import TargetImages
from tg4mm.fit.motion.temporal.synchronous import principal_components


def no_nuisance(observations: Observations) -> list[Nuisance]:
    return [_nothing] * len(observations.frames)


class _Nothing(Nuisance):
    """No columns, of no view."""

    def __init__(self) -> None:
        object.__setattr__(self, "active", np.zeros(12, bool))


_nothing = _Nothing()


def components(observations: Observations, most: int = 6) -> TargetImages:
    nuisances = no_nuisance(observations)
    look, config = picture_sums(observations, nuisances), MotionConfig(components=most)
    return principal_components(observations, look, nuisances, config)


def moving_pictures(
    n_cameras: int, n_timesteps: int, seed: int = 0, size: tuple[int, int] = (4, 5)
) -> tuple[np.ndarray, list[int], list[int]]:
    """Noise, opaque, timestep by timestep: data [C, H, W, 4], camera ids, timesteps."""
    rng = np.random.default_rng(seed)
    data = rng.integers(0, 256, (n_cameras * n_timesteps, *size, 4)).astype(np.uint8)
    data[..., 3] = 255
    ids = list(range(n_cameras)) * n_timesteps
    return data, ids, sorted(list(range(n_timesteps)) * n_cameras)
