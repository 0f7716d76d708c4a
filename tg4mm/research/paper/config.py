"""Settings of the presets `paper`, [TG4MM]'s own numbers (§IV.B), and `paper-tuned`, where it departs from them."""

from dataclasses import dataclass, replace

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.settings import setting
from tg4mm.core.values import POSITIVE, SEED, Number, require
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


_RULES = {
    "channels": Number(1, 1024),
    "resolution": Number(16, 4096),
    "mlp_layers": Number(0, 64),
    "mlp_width": Number(1, 4096),
    "warm_up": Number(1, MOST_ITERATIONS),
    "motion_iterations": Number(1, MOST_ITERATIONS),
    "learning_rate": POSITIVE,
    "motion_learning_rate": POSITIVE,
    "motion_rate_falls_to": Number(0, 1, above=True),
    "deviation": POSITIVE,
    "seed": SEED,
}


def checked(config: PaperConfig) -> PaperConfig:
    """`config`. Raises Tg4mmError on a value out of range."""
    for name, rule in _RULES.items():
        require(f"setting paper.{name}", getattr(config, name), rule, Tg4mmError)
    if config.resolution & (config.resolution - 1):
        raise Tg4mmError(
            f"setting paper.resolution is {config.resolution}, expected a power of two, 16 to 4096"
        )
    if not config.warm_up < config.iterations <= MOST_ITERATIONS:
        raise Tg4mmError(
            f"setting paper.iterations is {config.iterations}, expected more than paper.warm_up ({config.warm_up}), at "
            f"most {MOST_ITERATIONS:,}"
        )
    return config


def base_config(space: SpaceConfig, config: PaperConfig) -> SpaceConfig:
    """Settings of the base Gaussians' own fit: `paper.warm_up` iterations. Raises Tg4mmError where both are given."""
    if space.iterations not in (0, config.warm_up):
        raise Tg4mmError(
            f"setting space.iterations is {space.iterations}; with the preset paper it is paper.warm_up "
            f"({config.warm_up}), and paper.iterations counts both"
        )
    return replace(space, iterations=config.warm_up)
