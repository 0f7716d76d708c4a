"""The space stage of a run: rest views in, Gaussians and figures out, and going on after a kill."""

import time

from tg4mm.capture import SurfacePoints
from tg4mm.core.errors import RunError
from tg4mm.core.memory import reset_peak_memory
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space.checkpoint import Check, Checkpoint
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
    kept = _KeptInRun(run)
    fit = fit_space(views, points, config, device, kept)
    run.save_space(fit.gaussians, fit.figures | {"seconds": kept.unrecorded_s()})
    run.drop_checkpoint(_STAGE)
    return fit.gaussians


def train_plane(run: Run, views: RestViews, config: SpaceConfig, device: str = "cpu") -> Gaussians:
    """`fit_plane`, saved in the run with its figures. Returns the Gaussians (on the CPU)."""
    reset_peak_memory()
    fit = fit_plane(views, config, device)
    run.save_space(fit.gaussians, fit.figures)
    return fit.gaussians


class _KeptInRun:
    """`Kept` in a run's checkpoint. The run's log says how long the fit took up to it."""

    def __init__(self, run: Run) -> None:
        self._run, self._recorded = run, time.monotonic()

    def unrecorded_s(self) -> float:
        """Seconds that the run's log does not hold yet."""
        return time.monotonic() - self._recorded

    def load(self, check: Check) -> Checkpoint | None:
        checkpoint = self._run.load_checkpoint(_STAGE)
        if checkpoint is not None:
            try:
                check(*checkpoint)
            except RunError as error:
                file = self._run.part_file(f"checkpoint_{_STAGE}")
                raise RunError(f"{file}: {error}; delete it to start the {_STAGE} stage again") from None
        return checkpoint

    def save(self, checkpoint: Checkpoint, source: str | None) -> None:
        self._run.save_checkpoint(_STAGE, *checkpoint)
        init = {} if source is None else {"init": source}
        self._run.record(_STAGE, {"seconds": self.unrecorded_s(), **init})
        self._recorded = time.monotonic()
