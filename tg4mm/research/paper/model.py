"""The model of the preset `paper`: base Gaussians, space planes, decoder, and motion planes per timestep.

Files in the run folder, beside those every run has:

    RUN/triplane.safetensors        space planes [3, C, R, R], points, box, `base.*`, `decoder.*`
    RUN/planes_0001.safetensors …   motion planes of one timestep at the active cells, [C, A] (a channel in a row)
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.options import setting
from tg4mm.core.values import POSITIVE, SEED, Number, require
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space import SpaceConfig
from tg4mm.fit.space.config import MOST_ITERATIONS
from tg4mm.research.paper.triplane import BASE, Decoder, TouchedCells, cells_of, sample
from tg4mm.run import Run

TRIPLANE = "triplane"
_OWN = {"planes", "points", "box"}
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


@dataclass(frozen=True)
class PaperConfig:
    """Settings of both phases of [TG4MM]. One iteration is one view, white background, L1 (Eq. 16)."""

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
            f"setting space.iterations is {space.iterations}; with the preset paper it must equal paper.warm_up "
            f"({config.warm_up}): leave it out and set paper.warm_up; paper.iterations includes the warm-up"
        )
    return replace(space, iterations=config.warm_up)


@dataclass(frozen=True)
class PaperModel:
    """The scene at rest (timestep 0), and how embeddings become Gaussians."""

    planes: Tensor  # [3, C, R, R] float32: xy, xz, yz; row = second coordinate
    points: Tensor  # [N, 3] float32 scene units: where the planes are sampled, for good
    box: Tensor  # [2, 3] float64 scene units, normalised to 0..1
    base: dict[str, Tensor]  # attributes before activation, see `triplane.decoder.BASE`
    decoder: Decoder
    residual: bool = True

    @cached_property
    def cells(self) -> TouchedCells:
        return cells_of(self.points.numpy(), self.box.numpy(), self.planes.shape[-1])

    @property
    def channels(self) -> int:
        return self.planes.shape[1]

    def values(self) -> Tensor:
        """Return [A, C] the space planes at the active cells."""
        return active(self.planes, self.cells)

    @cached_property
    def rest_embedding(self) -> Tensor:
        """Return [N, 3 C] at timestep 0, [TG4MM] Eq. (5)."""
        return sample(self.values(), self.cells)

    def embedding(self, motion: Tensor) -> Tensor:
        """Return [N, 3 C] of a timestep from its motion planes at the active cells [A, C], [TG4MM] Eq. (6)."""
        own = sample(motion, self.cells)
        return self.rest_embedding + own if self.residual else own

    def decode(self, embedding: Tensor) -> Gaussians:
        return self.decoder.decode(self.base, embedding)

    def rest(self) -> Gaussians:
        """The Gaussians at timestep 0."""
        with torch.no_grad():
            return self.decode(self.rest_embedding)

    def figures(self) -> dict[str, Any]:
        """Sizes for the log. mib_two_triplanes is what [TG4MM] Fig. 6 counts as its model: 192 MiB there."""
        sizes = {
            "parameters_space_triplane": self.planes.numel(),
            "parameters_motion_triplane": self.planes.numel(),
            "parameters_decoder": sum(p.numel() for p in self.decoder.parameters.values()),
            "parameters_base": sum(p.numel() for p in self.base.values()),
        }
        return sizes | {
            "mib_two_triplanes": 2 * self.planes.numel() * 4 / 2**20,
            "active_cells": len(self.cells),
            "active_share": len(self.cells) / (3 * self.planes.shape[-1] ** 2),
        }


def active(planes: Tensor, cells: TouchedCells) -> Tensor:
    """Return [A, C] values of dense planes [3, C, R, R] at the active cells."""
    flat = planes.permute(1, 0, 2, 3).reshape(planes.shape[1], -1)
    return flat[:, torch.from_numpy(cells.dense)].T.contiguous()


def with_active(planes: Tensor, cells: TouchedCells, values: Tensor) -> Tensor:
    """Dense planes [3, C, R, R] with the active cells replaced by values [A, C]."""
    c, r = planes.shape[1], planes.shape[-1]
    flat = planes.permute(1, 0, 2, 3).reshape(c, -1).clone()
    flat[:, torch.from_numpy(cells.dense)] = values.T
    return flat.reshape(c, 3, r, r).permute(1, 0, 2, 3).contiguous()


# Files.


def has_model(run: Run) -> bool:
    """Return whether the run has a triplane model."""
    return run.has_part(TRIPLANE)


def save_model(run: Run, model: PaperModel) -> None:
    """Write the model into the run folder."""
    tensors = {"planes": model.planes, "points": model.points, "box": model.box}
    tensors |= {f"base.{k}": v for k, v in model.base.items()}
    tensors |= {f"decoder.{k}": v for k, v in model.decoder.parameters.items()}
    run.save_part(TRIPLANE, tensors, residual=model.residual)


def load_model(run: Run) -> PaperModel:
    """The model at rest. Raises RunError if absent, torn, foreign, of another run, or of shapes that do not fit."""
    tensors, header = run.load_part(TRIPLANE)
    file = run.part_file(TRIPLANE)
    base = {k: tensors.get(f"base.{k}") for k in BASE}
    decoder = {k.removeprefix("decoder."): v for k, v in tensors.items() if k.startswith("decoder.")}
    missing = [f"base.{k}" for k, v in base.items() if v is None] + sorted(_OWN - set(tensors))
    missing += [
        f"decoder.{k}.{part}" for k in BASE for part in ("weight", "bias") if f"{k}.{part}" not in decoder
    ]
    if missing:
        raise RunError(f"{file} has no tensor {missing[0]}")
    used = {k: v.dtype for k, v in tensors.items() if k in _OWN or k.startswith(("base.", "decoder."))}
    wrong = [k for k, v in used.items() if v != (torch.float64 if k == "box" else torch.float32)]
    if wrong:
        raise RunError(f"{file}: {wrong[0]} is {tensors[wrong[0]].dtype}, expected float32 (box: float64)")
    planes, points = tensors["planes"], tensors["points"]
    if planes.ndim != 4 or planes.shape[0] != 3 or planes.shape[2] != planes.shape[3]:
        raise RunError(f"{file}: planes have shape {tuple(planes.shape)}, expected (3, C, R, R)")
    box = tensors["box"]
    if points.ndim != 2 or points.shape[1] != 3 or box.shape != (2, 3):
        shapes = f"{tuple(points.shape)} and {tuple(box.shape)}"
        raise RunError(f"{file}: points and box have shapes {shapes}, expected (N, 3) and (2, 3)")
    model = PaperModel(
        planes, points, box, {k: v for k, v in base.items() if v is not None}, Decoder(decoder),
        bool(header.get("residual", True)),
    )  # fmt: skip
    try:
        model.rest()
    except (RuntimeError, ValueError, IndexError) as error:
        raise RunError(f"{file}: its tensors do not fit together ({' '.join(str(error).split())})") from None
    return model


def planes_name(t: int) -> str:
    """The part that holds the motion planes of timestep t."""
    return f"planes_{t:04d}"


def save_planes(run: Run, t: int, values: Tensor) -> None:
    """Keep the motion planes of timestep t, values [A, C] of the active cells."""
    run.save_part(planes_name(t), {"values": values.T.contiguous()})


def load_planes(run: Run, t: int, model: PaperModel) -> Tensor:
    """Return [A, C] motion planes of timestep t. Raises RunError if absent, torn, foreign or of another shape."""
    tensors, _ = run.load_part(planes_name(t))
    expected = (model.channels, len(model.cells))
    values = tensors.get("values")
    if values is None or tuple(values.shape) != expected or values.dtype != torch.float32:
        found = None if values is None else f"{tuple(values.shape)} {values.dtype}"
        raise RunError(
            f"{run.part_file(planes_name(t))}: values have shape {found}, expected {expected} float32: "
            f"{expected[0]} channels at the {expected[1]} cells of {run.part_file(TRIPLANE).name}"
        )
    return values.T.contiguous()


def plane_video(run: Run, model: PaperModel, n_timesteps: int, k: int, channel: int) -> np.ndarray:
    """Return [T, R, R] float32: one feature plane over time, space and motion planes together; a row of each file."""
    r = model.planes.shape[-1]
    still = model.planes[k, channel].numpy().reshape(-1)
    part = model.cells.of_plane(k)
    where = model.cells.dense[part] - k * r * r
    video = np.empty((n_timesteps, r * r), np.float32)
    video[0] = still
    for t in range(1, n_timesteps):
        video[t] = still if model.residual else 0.0
        own = run.part_rows(planes_name(t), "values", channel)[part.start : part.stop]
        video[t, where] = video[t, where] + own if model.residual else own
    return video.reshape(n_timesteps, r, r)


def disk_mib(run: Run) -> float:
    """Size of the run's model files, MiB."""
    return (
        sum(f.stat().st_size for f in Path(run.path).glob("*.safetensors") if "checkpoint" not in f.name)
        / 2**20
    )
