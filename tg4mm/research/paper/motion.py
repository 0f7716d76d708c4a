"""Phase 2 of [TG4MM]: for each timestep a motion triplane added to the frozen space planes."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from tg4mm.capture import Capture, ImageStack
from tg4mm.core.errors import CaptureError
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.core.phasors import series_modes
from tg4mm.core.progress import Update, progress
from tg4mm.core.work_folder import StageCheckpoint
from tg4mm.fit.device import full_precision, gpu_figures, reset_gpu_peak
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.space import RestViews
from tg4mm.fit.space.view import render_view
from tg4mm.research.paper.model import (
    PaperConfig,
    PaperModel,
    disk_mib,
    load_planes,
    planes_name,
    save_planes,
)
from tg4mm.research.paper.space import Fit, cameras_on, views_at
from tg4mm.research.paper.triplane import Decoder, sample
from tg4mm.run import Run

_STAGE = "motion"


class _Stage:
    def __init__(
        self,
        run: Run,
        model: PaperModel,
        config: PaperConfig,
        kept: StageCheckpoint,
        device: str,
        first: "AtRest | None" = None,
    ) -> None:
        self.first = first
        self.run, self.model, self.config, self.device = run, model, config, device
        self.cells = model.cells
        self.rest = model.rest_embedding.to(device)
        self.base = {k: v.to(device) for k, v in model.base.items()}
        self.decoder = Decoder({k: v.to(device) for k, v in model.decoder.parameters.items()})
        self.kept = kept

    def fit(self, t: int, views, iterations: int, update: Update) -> Tensor:
        """Fit the motion planes [A, C] of timestep t."""
        zero = {"values": torch.zeros(len(self.cells), self.model.channels)}
        c = self.config
        fit = Fit(zero, c.motion_learning_rate, iterations, c.seed + t, self.device, c.motion_rate_falls_to)
        checkpoint = self.kept.load()
        if checkpoint is not None and checkpoint[1]["timestep"] == t:
            fit.restore(*checkpoint)

        def decoded(p: dict[str, Tensor]) -> Gaussians:
            embedding = sample(p["values"], self.cells)
            return self.decoder.decode(self.base, self.rest + embedding if self.model.residual else embedding)

        cameras = cameras_on(self._compared(views), self.device)
        fit.run(cameras, decoded, self.kept, update, (t - 1) * iterations, timestep=t)
        self.loss = float(fit.loss)
        return fit.parameters["values"].detach().cpu()

    def _compared(self, views: RestViews) -> RestViews:
        """Return the targets of phase 2: the pictures or, for the difference loss, a rendering plus a change.

        That is the model's rendering at rest plus the pictures' change since timestep 0, so that |rendered − target| is
        |rendered change − observed change|.
        """
        if self.first is None:
            return views
        same = [self.first.row_of(views, v) for v in range(len(views.rgb))]
        return replace(views, rgb=views.rgb + self.first.missing[same])


def train_timesteps(
    run: Run,
    model: PaperModel,
    capture: Capture,
    images: ImageStack,
    config: PaperConfig,
    device: str = "cpu",
) -> ModalMotion:
    """Fit the motion planes of timesteps 1 … T − 1, one file each, and save the decoded motion in the run.

    Finished timesteps are kept, an unfinished one continues from its checkpoint. The log's stage `motion` gets seconds,
    peak_memory_mib, iterations (in all), iterations_per_timestep, l1_train (of the last), n_frequencies, mib_on_disk.
    """
    kept = StageCheckpoint(run, _STAGE)
    reset_peak_memory()
    reset_gpu_peak(device)
    first = at_rest(model, views_at(capture, images, 0)) if config.difference else None
    stage = _Stage(run, model, config, kept, device, first)
    iterations = config.per_timestep(capture.n_timesteps)
    steps = range(1, capture.n_timesteps)
    todo = [t for t in steps if not run.has_part(planes_name(t))]
    done = (len(steps) - len(todo)) * iterations
    with progress("motion triplanes", len(steps) * iterations, start=done) as update, full_precision(device):
        for t in todo:
            values = stage.fit(t, views_at(capture, images, t), iterations, update)
            save_planes(run, t, values)
            kept.drop()
            kept.record()
    motion = modal_of_series(model, (load_planes(run, t, model) for t in steps), capture.fps)
    figures = {
        "seconds": kept.unrecorded_s,
        "peak_memory_mib": peak_memory_mib(),
        **gpu_figures(device),
        "iterations": len(steps) * iterations,
        "iterations_per_timestep": iterations,
        "n_frequencies": len(motion.freqs_hz),
        **({"l1_train": stage.loss} if todo else {}),
    }
    run.save_motion(motion, figures)
    run.record(_STAGE, {"mib_on_disk": disk_mib(run)})
    kept.drop()
    return motion


@dataclass(frozen=True)
class AtRest:
    """The cameras of timestep 0, with the difference of rendering and picture."""

    viewmats: np.ndarray  # [V, 4, 4] float32
    Ks: np.ndarray  # [V, 3, 3] float32
    missing: np.ndarray  # [V, H, W, 3] float32: rendered at rest − picture of timestep 0

    def row_of(self, views: RestViews, v: int) -> int:
        """Return the index of the camera of picture v of `views`. Raises CaptureError if it has moved."""
        same = (self.viewmats == views.viewmats[v]).all((1, 2)) & (self.Ks == views.Ks[v]).all((1, 2))
        if not same.any():
            raise CaptureError(
                "setting paper.difference is true, which needs fixed cameras, but a camera moved"
            )
        return int(same.argmax())


@torch.no_grad()
def at_rest(model: PaperModel, views: RestViews) -> AtRest:
    """Render the model at rest from the cameras of timestep 0, over white."""
    gaussians = model.rest()
    size = views.rgb.shape[2], views.rgb.shape[1]
    rendered = [
        render_view(
            gaussians, torch.from_numpy(viewmat), torch.from_numpy(K), size, gaussians.sh_degree
        ).rgb.numpy()
        for viewmat, K in zip(views.viewmats, views.Ks, strict=True)
    ]
    return AtRest(views.viewmats, views.Ks, np.stack(rendered) - views.rgb)


def rotation_between(start: Tensor, end: Tensor) -> Tensor:
    """Return rotation vectors [N, 3], radians, world axes, from quaternions [N, 4] `start` to `end`."""
    a, b = (torch.nn.functional.normalize(q.double(), dim=1) for q in (start, end))
    # b ā, with the sign of the smaller turn
    w = (a * b).sum(1)
    v = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - torch.linalg.cross(b[:, 1:], a[:, 1:])
    v = torch.where((w < 0)[:, None], -v, v)
    length = torch.linalg.vector_norm(v, dim=1, keepdim=True)
    angle = 2 * torch.atan2(length, w.abs()[:, None])
    return torch.where(length > 1e-12, v / length.clamp_min(1e-12) * angle, 2 * v)


@torch.no_grad()
def modal_of_series(model: PaperModel, planes: Iterable[Tensor], fps: float) -> ModalMotion:
    """Return the motion since timestep 0 of the Gaussians decoded from motion planes [A, C] of timesteps from 1 on."""
    rest = model.rest()
    changes = [torch.zeros(len(rest), 6, dtype=torch.float64)]
    for values in planes:
        now = model.decode(model.embedding(values))
        shift = now.means.double() - rest.means.double()
        changes.append(torch.cat([shift, rotation_between(rest.quats, now.quats)], 1))
    freqs, phasors = series_modes(torch.stack(changes).numpy(), fps)
    return ModalMotion.of_phasors(freqs, phasors[..., :3], phasors[..., 3:], fps, len(changes))
