"""Settings of the presets `paper`, [TG4MM]'s own numbers (§IV.B), and `paper-tuned`, where it departs from them.

What each departure brings is measured in docs/paper.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.settings import setting
from tg4mm.fit.space import SpaceConfig
from tg4mm.fit.space.config import MOST_ITERATIONS


@dataclass(frozen=True)
class PaperConfig:
    """Both phases of [TG4MM]. One iteration is one view, white background, L1 (Eq. 16)."""

    channels: int = setting(32, "C, number of features of a plane")
    resolution: int = setting(512, "R, cells along each side of a plane; a power of two", "cells")
    mlp_layers: int = setting(
        0, 'layers before the heads; [TG4MM]: 8 in Table VI ("MLP + Decoder"), 1 in §IV.B', "layers"
    )
    mlp_width: int = setting(256, "width of each of these layers", "features")
    iterations: int = setting(20_000, "iterations of phase 1, including those of paper.warm_up", "iterations")
    warm_up: int = setting(
        3_000,
        "first iterations of phase 1, which fit only the base Gaussians, with density control, as 4DGS does",
        "iterations",
    )
    motion_iterations: int = setting(7_000, "iterations of phase 2 for each timestep", "iterations")
    shared: bool = setting(False, "true: all timesteps share paper.motion_iterations")
    learning_rate: float = setting(1e-4, "learning rate of Adam in phase 1, fixed")
    motion_learning_rate: float = setting(1e-4, "learning rate of Adam in phase 2")
    motion_rate_falls_to: float = setting(1.0, "fraction of that rate at the end of a timestep; 1: fixed")
    deviation: float = setting(1.0, "standard deviation of the initial values of the space planes")
    residual: bool = setting(
        True,
        "true: a timestep's planes are added to the space planes; false: they replace them ([TG4MM] Fig. 8)",
    )
    difference: bool = setting(
        False, "true: phase 2 compares changes since timestep 0; false: pictures, [TG4MM] Eq. (16)"
    )
    seed: int = setting(0, "seed of the random generator")

    def per_timestep(self, n_timesteps: int) -> int:
        """Iterations of phase 2 for each of the T − 1 timesteps after the first."""
        shared = max(self.motion_iterations // max(n_timesteps - 1, 1), 1)
        return shared if self.shared else self.motion_iterations


PAPER = PaperConfig()
PAPER_TUNED = PaperConfig(
    channels=16, resolution=64, iterations=3_000, warm_up=1_500, motion_iterations=200,
    motion_rate_falls_to=0.03, difference=True,
)  # fmt: skip


def checked(config: PaperConfig) -> PaperConfig:
    """`config`. Raises Tg4mmError on a value out of range."""
    c = config
    power = c.resolution > 0 and c.resolution & (c.resolution - 1) == 0
    checks = {
        "channels": (1 <= c.channels <= 1024, "1 to 1024"),
        "resolution": (power and 16 <= c.resolution <= 4096, "a power of two, 16 to 4096"),
        "mlp_layers": (0 <= c.mlp_layers <= 64, "0 to 64"),
        "mlp_width": (1 <= c.mlp_width <= 4096, "1 to 4096"),
        "warm_up": (1 <= c.warm_up <= MOST_ITERATIONS, f"1 to {MOST_ITERATIONS:,}"),
        "iterations": (
            c.warm_up < c.iterations <= MOST_ITERATIONS,
            f"more than paper.warm_up ({c.warm_up}), at most {MOST_ITERATIONS:,}",
        ),
        "motion_iterations": (1 <= c.motion_iterations <= MOST_ITERATIONS, f"1 to {MOST_ITERATIONS:,}"),
        "learning_rate": (math.isfinite(c.learning_rate) and c.learning_rate > 0, "> 0"),
        "motion_learning_rate": (math.isfinite(c.motion_learning_rate) and c.motion_learning_rate > 0, "> 0"),
        "motion_rate_falls_to": (0 < c.motion_rate_falls_to <= 1, "above 0, up to 1"),
        "deviation": (math.isfinite(c.deviation) and c.deviation > 0, "> 0"),
        "seed": (0 <= c.seed < 1 << 63, "0 to 2⁶³ − 1"),
    }
    for name, (good, expected) in checks.items():
        if not good:
            raise Tg4mmError(f"setting paper.{name} is {getattr(c, name)}, expected {expected}")
    return config


def base_config(space: SpaceConfig, config: PaperConfig) -> SpaceConfig:
    """Settings of the base Gaussians' own fit: `paper.warm_up` iterations. Raises Tg4mmError where both are given."""
    if space.iterations not in (0, config.warm_up):
        raise Tg4mmError(
            f"setting space.iterations is {space.iterations}; with the preset paper it is paper.warm_up "
            f"({config.warm_up}), and paper.iterations counts both"
        )
    return replace(space, iterations=config.warm_up)
