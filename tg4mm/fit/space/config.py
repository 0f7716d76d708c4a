"""Settings of the space stage."""

from dataclasses import dataclass

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import setting
from tg4mm.core.values import NOT_NEGATIVE, SEED, Choice, Either, Just, Number, require

MOST_ITERATIONS = 100_000_000  # a year of them
MOST_GAUSSIANS = 100_000_000  # what a run of 20 GB holds
MOST_LEVELS = 12
INITS = ("auto", "points", "sfm", "hull", "random")
_RULES = {
    "iterations": Number(0, MOST_ITERATIONS),
    "max_gaussians": Either(Just(0), Number(4, MOST_GAUSSIANS)),
    "levels": Number(0, MOST_LEVELS),
    "sh_degree": Number(0, 3),
    "l2": NOT_NEGATIVE,
    "dssim": Number(0, 1),
    "init": Choice(*INITS),
    "init_points": Number(4, MOST_GAUSSIANS),
    "seed": SEED,
}


@dataclass(frozen=True)
class SpaceConfig:
    """Settings of the static Gaussians' fit. Learning rates and their decay: `parameters.py`."""

    iterations: int = setting(
        0,
        "number, of one view each; 0: 150 · ∛(pixels of the object in a view), 1,000 … 30,000; half if levels > 1",
        "iterations",
    )
    max_gaussians: int = setting(
        0, "largest number; 0: 200 · √(pixels of the object in a view), 2,000 … 500,000", "Gaussians"
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
        5_000, "largest number at the start; a fifth of it from the hull, a tenth at random places", "points"
    )
    mask: str = setting(
        "",
        "valid part of the one fixed camera's pictures: a PNG's path (white), or a polygon X,Y X,Y X,Y …; "
        "empty: everything",
    )
    seed: int = setting(0, "of random draws")


def checked(config: SpaceConfig) -> SpaceConfig:
    """`config`. Raises Tg4mmError on a value out of range."""
    for name, rule in _RULES.items():
        require(f"setting space.{name}", getattr(config, name), rule, Tg4mmError)
    return config
