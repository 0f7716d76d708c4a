"""The space stage of a run: rest views in, Gaussians and figures out, and going on after a kill."""

from tg4mm.capture import SurfacePoints
from tg4mm.core.checkpoint import Checkpoint
from tg4mm.core.memory import reset_peak_memory
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space.config import SpaceConfig
from tg4mm.fit.space.plane import fit_plane
from tg4mm.fit.space.targets import RestViews
from tg4mm.fit.space.train import fit_space
from tg4mm.run import Run

_STAGE = "space"


def train_space(
    run: Run, views: RestViews, points: SurfacePoints | None, config: SpaceConfig, device: str = "cpu"
) -> Gaussians:
    """`fit_space`, kept in the run: RUN/checkpoint_space.safetensors while it goes on, then RUN/space.safetensors.

    Returns the Gaussians (on the CPU). The run's log gets the figures of `SpaceFit`. Raises what `fit_space` raises.
    """
    reset_peak_memory()
    kept = Checkpoint(run, _STAGE)
    fit = fit_space(views, points, config, device, kept)
    run.save_space(fit.gaussians, fit.figures)
    kept.drop()
    return fit.gaussians


def train_plane(run: Run, views: RestViews, config: SpaceConfig, device: str = "cpu") -> Gaussians:
    """`fit_plane`, saved in the run with its figures. Returns the Gaussians (on the CPU)."""
    reset_peak_memory()
    fit = fit_plane(views, config, device)
    run.save_space(fit.gaussians, fit.figures)
    return fit.gaussians
