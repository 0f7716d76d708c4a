"""Settings of the space stage."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.settings import setting

MOST_ITERATIONS = 100_000_000  # a year of them
MOST_GAUSSIANS = 100_000_000  # what a run of 20 GB holds
MOST_LEVELS = 12
INITS = ("auto", "points", "sfm", "hull", "random")


@dataclass(frozen=True)
class SpaceConfig:
    """How the static Gaussians are fitted. Learning rates and their decay: `parameters.py`."""

    iterations: int = setting(
        0,
        "of one view each; 0: 150 · ∛(pixels that the object covers in a view), 1,000 … 30,000; half if levels > 1",
        "iterations",
    )
    max_gaussians: int = setting(
        0, "largest number; 0: 200 · √(pixels that the object covers in a view), 2,000 … 500,000", "Gaussians"
    )
    levels: int = setting(
        0,
        "number of picture sizes from coarse to fine, each twice the last; 0: until the coarsest is at most "
        "600 pixels wide and high",
    )
    gains: bool = setting(
        False,
        "learn a gain for each picture and channel; helps if exposure or white balance differ by 5 % or more",
    )
    sh_degree: int = setting(
        3, "degree of spherical harmonics, 0 … 3; raised step by step in the first 30 % of the iterations"
    )
    l2: float = setting(10.0, "weight of the squared error, added to L1; 0 is [TG4MM] Eq. (16)")
    dssim: float = setting(0.0, "fraction of D-SSIM in the loss, 0 … 1, [3DGS] Eq. (7)")
    init: str = setting(
        "auto",
        "where Gaussians start: points, hull, random, auto (the first of these that the data allow), or sfm (pycolmap)",
    )
    init_points: int = setting(
        5_000, "at most; a fifth of it from the hull, a tenth at random places", "points"
    )
    seed: int = setting(0, "of random draws")


def checked(config: SpaceConfig) -> SpaceConfig:
    """`config`. Raises Tg4mmError on a value out of range."""
    checks = {
        "iterations": (0 <= config.iterations <= MOST_ITERATIONS, f"0 to {MOST_ITERATIONS:,}"),
        "max_gaussians": (
            config.max_gaussians == 0 or 4 <= config.max_gaussians <= MOST_GAUSSIANS,
            f"0, or 4 to {MOST_GAUSSIANS:,}",
        ),
        "levels": (0 <= config.levels <= MOST_LEVELS, f"0 to {MOST_LEVELS}"),
        "sh_degree": (0 <= config.sh_degree <= 3, "0 to 3"),
        "l2": (math.isfinite(config.l2) and config.l2 >= 0, ">= 0"),
        "dssim": (0 <= config.dssim <= 1, "0 to 1"),
        "init": (config.init in INITS, ", ".join(INITS)),
        "init_points": (4 <= config.init_points <= MOST_GAUSSIANS, f"4 to {MOST_GAUSSIANS:,}"),
        "seed": (0 <= config.seed < 1 << 63, "0 to 2⁶³ − 1"),
    }
    for name, (good, expected) in checks.items():
        if not good:
            raise Tg4mmError(f"setting space.{name} is {getattr(config, name)}, expected {expected}")
    return config
