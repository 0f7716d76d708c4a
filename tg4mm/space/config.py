"""Settings of the space stage."""

from __future__ import annotations

from dataclasses import dataclass

MOST_ITERATIONS = 100_000_000  # a year of them
MOST_GAUSSIANS = 100_000_000  # what a run of 20 GB holds


@dataclass(frozen=True)
class SpaceConfig:
    """How the static Gaussians are fitted. Learning rates and their decay: `parameters.py`."""

    iterations: int = 0  # one view each; 0: 150 · ∛(pixels the object covers in a view), 1,000 … 30,000
    max_gaussians: int = 0  # 0: 200 · √(the same), 2,000 … 500,000
    sh_degree: int = 3  # reached step by step in the first 30 % of the iterations
    l2: float = 10.0  # weight of the squared error beside L1; 0 is [TG4MM] Eq. (16)
    dssim: float = 0.0  # share of D-SSIM, [3DGS] Eq. (7)
    init: str = (
        "auto"  # "points", "hull", "random", "auto" (the first that the data allow), or "sfm" (pycolmap)
    )
    init_points: int = 5_000  # at most; a fifth of it from the hull, a tenth at random places
    seed: int = 0
