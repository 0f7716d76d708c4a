"""3DMM, the Eulerian method in [TG4MM] Table I, at a size that two threads of a CPU can train.

A `PlaneField` is fitted to timestep 0, then only differences of its planes for each later timestep, from zero. Planes
plus differences over time are magnified by phase, as published; those fitted with total variation on the differences
are magnified by `linear`. Departures from [3DMM]: planes of 16 × 64² (32 × 512²), no proposal networks,
fewer and faster iterations (10,000 at 1e-4 for a timestep there), harmonics of degree 2.

Files in RUN, beside config.json and log.json: field.safetensors (timestep 0), phase_0001 … and linear_0001 …
(differences of one timestep, [3, R, R, C]). A killed fit continues at its part.
"""

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.capture import Capture, ImageStack, load_capture, load_images
from tg4mm.core.errors import CaptureError
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.core.progress import Update, progress
from tg4mm.fit.magnify import PhaseMagnifier, magnified_series
from tg4mm.fit.space import RestViews
from tg4mm.research.bench.methods import Pictures, row_title
from tg4mm.research.bench.methods.planes import (
    Place,
    PlaneField,
    centres,
    march,
    place_of,
    rays_of,
    sample,
    total_variation,
)
from tg4mm.research.bench.methods.video import band_response
from tg4mm.research.bench.request import BenchPlan
from tg4mm.research.bench.sets import BenchSet
from tg4mm.research.evaluate.run import STATIC
from tg4mm.research.evaluate.scores import camera_key
from tg4mm.research.paper.space import views_at
from tg4mm.run import Run

NAME = "3dmm"
WAYS = ("phase", "linear")
_VERSION = 1  # of fit and pictures; to be raised when the same settings would give other pictures
_TV_EVERY = 4  # iterations
_EMPTY_EVERY, _LOOKED_EVERY = 8, 250  # iterations
_RAYS_AT_ONCE = 4096
_WARM_UP = 0.05  # share of the iterations in which the rate rises; all along it falls as a cosine
_IS_FILLED = 0.001  # density times a step


@dataclass(frozen=True)
class EulerianConfig:
    """Sizes, iterations and Adam's rates. `smoothness`: weight of the total variation of planes."""

    resolution: int = 64  # cells along each side of a plane; a power of two
    channels: int = 16
    iterations: int = 2000  # of timestep 0
    motion_iterations: int = 200  # of each other timestep, for each of the two ways
    rays: int = 1024  # of an iteration
    rate: float = 1e-2
    motion_rate: float = 1e-3
    smoothness: float = 1e-2
    motion_smoothness: float = 1.0  # of differences that are magnified by `linear`
    margin: int = 4  # cells of 64 by which the visual hull is grown
    seed: int = 0


@dataclass(frozen=True)
class Eulerian:
    """A `Method` with rows of the field at rest, and its differences magnified by phase and by linear."""

    config: EulerianConfig = EulerianConfig()
    name: str = NAME

    @property
    def rows(self) -> tuple[str, ...]:
        return tuple(row_title(NAME, way) for way in (STATIC, *WAYS))

    def fit(self, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        capture = load_capture(data.root)
        run = Run.create(place / "run", data.root, NAME, {NAME: asdict(self.config)})
        if not run.has_part(_part(capture.n_timesteps - 1, WAYS[-1])):
            _fit(run, capture, load_images(capture), self.config)
        return {}

    def recipe(self, row: str, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        return {"row": row, "version": _VERSION, **asdict(self), "band_hz": plan.band(data)}

    def render(
        self, row: str, data: BenchSet, place: Path, capture: Capture, alpha: float, plan: BenchPlan
    ) -> Pictures:
        run = Run.open(place / "run")
        field = _load_field(run, self.config)
        if row == self.rows[0]:
            return _drawn(field, None, capture)
        way = WAYS[self.rows.index(row) - 1]
        planes = field.planes.numpy()
        steps = range(1, data.n_timesteps)
        changes = [run.load_part(_part(t, way))[0]["planes"].numpy() for t in steps]
        video = np.stack([planes, *(planes + d for d in changes)])
        return _drawn(field, magnified(video, band_response(data, alpha, plan), way), capture)


def magnified(video: np.ndarray, response: np.ndarray, way: str) -> np.ndarray:
    """Magnify planes over time [T, 3, R, R, C]; response [T // 2 + 1]: α times the temporal filter's."""
    if way == "linear":
        flat = video.reshape(len(video), -1)
        return magnified_series(flat, response).reshape(video.shape)
    phase = PhaseMagnifier((video.shape[2], video.shape[3]), response)
    out = np.empty_like(video)
    for k in range(3):
        for c in range(video.shape[4]):
            out[:, k, :, :, c] = phase(np.ascontiguousarray(video[:, k, :, :, c]))
    return out


def _part(t: int, way: str) -> str:
    return f"{way}_{t:04d}"


def _fit(run: Run, capture: Capture, images: ImageStack, config: EulerianConfig) -> None:
    """Fit every missing part."""
    first = views_at(capture, images, 0)
    if len(first.rgb) < 2:
        raise CaptureError(
            f"{capture.root}: timestep 0 has one picture, and {NAME} needs several views of it"
        )
    reset_peak_memory()
    if not run.has_part("field"):
        began = time.monotonic()
        place = place_of(first, config.margin)
        field = PlaneField(
            place, config.resolution, config.channels, torch.Generator().manual_seed(config.seed)
        )
        with progress(f"{NAME}: timestep 0", config.iterations) as update:
            fit_at_rest(field, SeenPixels(first, place, config.seed), config, update)
        box, filled = torch.from_numpy(place.box), torch.from_numpy(place.filled).float()
        run.save_part("field", field.state_dict() | {"box": box, "filled": filled})
        run.record("space", _figures(began, config.iterations))
    field = _load_field(run, config)
    field.place = occupied(field, field.planes)
    n, steps = config.motion_iterations, range(1, capture.n_timesteps)
    with progress(f"{NAME}: differences", len(steps) * len(WAYS) * n) as update:
        for t in steps:
            if run.has_part(_part(t, WAYS[-1])):
                continue
            began = time.monotonic()
            seen = SeenPixels(views_at(capture, images, t), field.place, config.seed + t)
            for k, way in enumerate(WAYS):
                own = differences(field, seen, way, config)
                run.save_part(_part(t, way), {"planes": own})
                update(((t - 1) * len(WAYS) + k + 1) * n)
            run.record("motion", _figures(began, len(steps) * len(WAYS) * n))


def _figures(began: float, iterations: int) -> dict[str, float]:
    seconds = time.monotonic() - began
    return {"seconds": seconds, "peak_memory_mib": peak_memory_mib(), "iterations": iterations}


def _load_field(run: Run, config: EulerianConfig) -> PlaneField:
    """Load the field of timestep 0, without gradients."""
    tensors, _ = run.load_part("field")
    place = Place(tensors.pop("box").numpy(), tensors.pop("filled").numpy() > 0)
    field = PlaneField(place, config.resolution, config.channels, torch.Generator())
    field.load_state_dict(tensors)
    return field.requires_grad_(False)


class SeenPixels:
    """Random pixels of one timestep with rays through filled cells."""

    def __init__(self, views: RestViews, place: Place, seed: int) -> None:
        origins, directions = rays_of(views.viewmats, views.Ks, views.size)
        start = np.full(len(origins), 0.5, np.float32)
        meets = np.unique(march(origins, directions, place.box, place.filled, place.step, start)[0])
        cover = views.alpha.reshape(-1, 1)[meets]
        ink = views.rgb.reshape(-1, 3)[meets] - (1 - cover)  # over black
        arrays = origins[meets], directions[meets], ink, cover
        self._origins, self._directions, self._ink, self._cover = map(torch.from_numpy, arrays)
        self._draw = torch.Generator().manual_seed(seed)

    def loss(self, field: PlaneField, planes: Tensor, count: int, place: Place | None = None) -> Tensor:
        """Return the mean square error of `count` pixels over random backgrounds; place: of `PlaneField.render`."""
        some = torch.randint(len(self._ink), (count,), generator=self._draw)
        behind = torch.rand(count, 3, generator=self._draw)
        start = torch.rand(count, generator=self._draw)
        drawn = field.render(planes, (self._origins[some], self._directions[some]), behind, start, place)
        return (drawn - self._ink[some] - (1 - self._cover[some]) * behind).square().mean()


def fit_at_rest(field: PlaneField, seen: SeenPixels, config: EulerianConfig, update: Update) -> None:
    """Fit the complete field. Empty cells have samples in one iteration of `_EMPTY_EVERY`, so that they stay empty."""
    c, place = config, field.place

    def loss(i: int) -> Tensor:
        nonlocal place
        if i and i % _LOOKED_EVERY == 0:
            place = occupied(field, field.planes)
        return seen.loss(field, field.planes, c.rays, field.place if i % _EMPTY_EVERY == 0 else place)

    how = c.iterations, c.rate, c.smoothness
    _descend((list(field.parameters()), field.planes), loss, how, update)


def differences(field: PlaneField, seen: SeenPixels, way: str, config: EulerianConfig) -> Tensor:
    """Fit the differences [3, R, R, C] of a timestep's planes from those at rest, smooth ones for `linear`."""
    own = torch.zeros_like(field.planes).requires_grad_()
    c, smoothness = config, config.motion_smoothness if way == "linear" else 0.0

    def loss(i: int) -> Tensor:
        return seen.loss(field, field.planes + own, c.rays)

    _descend(([own], own), loss, (c.motion_iterations, c.motion_rate, smoothness))
    return own.detach()


def _descend(
    what: tuple[list[Tensor], Tensor],
    loss_of: Callable[[int], Tensor],
    how: tuple[int, float, float],
    update: Update | None = None,
) -> None:
    """Run Adam on (parameters, the smooth planes among them); how: iterations, rate, smoothness."""
    (parameters, smooth), (n, rate, smoothness) = what, how
    adam = torch.optim.Adam(parameters, lr=rate, eps=1e-12, fused=True)
    for i in range(n):
        rises = min(1.0, (i + 1) / max(_WARM_UP * n, 1))
        adam.param_groups[0]["lr"] = rate * rises * (0.5 + 0.5 * math.cos(math.pi * i / n))
        loss = loss_of(i)
        if smoothness and i % _TV_EVERY == 0:
            loss = loss + _TV_EVERY * smoothness * total_variation(smooth)
        loss.backward()
        adam.step()
        adam.zero_grad(set_to_none=True)
        if update is not None:
            update(i + 1)


@torch.no_grad()
def occupied(field: PlaneField, planes: Tensor) -> Place:
    """Return the field's place without cells that are empty, with their neighbours, by these planes."""
    from scipy.ndimage import maximum_filter

    box, filled = field.place.box, field.place.filled
    points = torch.from_numpy(centres(np.array([[0.0] * 3, [1.0] * 3]))[filled.reshape(-1)])
    logs = field.density(sample(planes, points))[:, 0]
    cells = np.zeros_like(filled)
    cells[filled] = (logs.exp() * field.place.step > _IS_FILLED).numpy()
    return Place(box, maximum_filter(cells, 3) & filled)


@torch.no_grad()
def _drawn(field: PlaneField, video: np.ndarray | None, capture: Capture) -> Pictures:
    """Yield a capture's pictures by planes over time [T, 3, R, R, C]; None: at rest, each camera drawn once."""
    size = capture.width, capture.height
    planes: Tensor = field.planes
    place, known = occupied(field, planes), dict[bytes, np.ndarray]()
    for t in np.unique(capture.timesteps).tolist():
        if video is not None:
            planes, known = torch.from_numpy(video[t]), {}
            place = occupied(field, planes)
        for i in np.flatnonzero(capture.timesteps == t).tolist():
            camera = camera_key(capture, i)
            if camera not in known:
                rays = rays_of(capture.viewmats[i : i + 1], capture.Ks[i : i + 1], size)
                known[camera] = _picture(field, planes, place, rays).reshape(*size[::-1], 3)
            yield i, known[camera]


def _picture(
    field: PlaneField, planes: Tensor, place: Place, rays: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    parts = []
    for first in range(0, len(rays[0]), _RAYS_AT_ONCE):
        origins, directions = (torch.from_numpy(r[first : first + _RAYS_AT_ONCE]) for r in rays)
        white, middle = torch.ones(len(origins), 3), torch.full((len(origins),), 0.5)
        parts.append(field.render(planes, (origins, directions), white, middle, place))
    return torch.cat(parts).clamp(0, 1).numpy()
