"""The presets `paper` and `paper-tuned`: fitting, and poses magnified in the embedding of time.

Each of the 3 C feature planes over time is a video. `phase` magnifies it as [TG4MM] does and samples it at the points;
`linear` samples first. The result, [3 C, T, N] float32, lies in a memory-mapped file, RUN/magnified/<digest>.f32, so
neither making nor using it holds more than one video and one timestep; a killed job goes on at the next channel, and a
second request for the same finds it there. <digest>.json holds a checksum of each finished channel: a file that is
not what was written is made anew. The latest four are kept.
"""

import os
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock, Timeout

from tg4mm.capture import Capture, load_images
from tg4mm.core.files import give_back, json_digest, rename, write_json
from tg4mm.core.magnification import Magnification, bins
from tg4mm.core.memory import reserve
from tg4mm.core.progress import progress
from tg4mm.core.untrusted import read_formed
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.magnify import PhaseMagnifier, PyramidConfig, magnified_series
from tg4mm.fit.space import SpaceConfig
from tg4mm.fit.space.config import checked as checked_space
from tg4mm.research.paper.model import (
    PAPER,
    PAPER_TUNED,
    PaperModel,
    base_config,
    checked,
    has_model,
    load_model,
    plane_video,
)
from tg4mm.research.paper.motion import train_timesteps
from tg4mm.research.paper.space import first_views, train_triplane
from tg4mm.research.paper.triplane import Decoder, TouchedCells
from tg4mm.run import Run
from tg4mm.run.preset import Poses, Preset
from tg4mm.run.stages import train_space
from tg4mm.run.tensor_file import model_hash

_VERSION = 1  # of how they are made: raise it when the same request would give other numbers
_KEPT = 4
FOLDER = "magnified"


class EmbeddingSeries:
    """Embeddings over time that decode to Gaussians at any time; past the last timestep they begin anew."""

    def __init__(self, embeddings: np.ndarray, model: PaperModel, fps: float, device: str = "cpu") -> None:
        """embeddings [3 C, T, N]; a memory map will do."""
        self.embeddings, self.fps, self.device = embeddings, fps, device
        self._base = {k: v.to(device) for k, v in model.base.items()}
        self._decoder = Decoder({k: v.to(device) for k, v in model.decoder.parameters.items()})

    @property
    def n_timesteps(self) -> int:
        return self.embeddings.shape[1]

    @torch.no_grad()
    def at(self, t: float) -> Gaussians:
        """The Gaussians at timestep t; between timesteps by the trigonometric interpolation of the T embeddings."""
        n = self.n_timesteps
        if float(t).is_integer():
            now = np.ascontiguousarray(self.embeddings[:, int(t) % n].T)
        else:
            now = np.einsum("s,csn->nc", interpolation(t, n).astype(np.float32), self.embeddings)
        return self._decoder.decode(self._base, torch.from_numpy(now).to(self.device))


def interpolation(t: float, n: int) -> np.ndarray:
    """Return [n] weights of the timesteps 0 … n − 1 at time t, of the periodic band-limited function through them."""
    lag = t - np.arange(n)
    k = np.arange(1, (n + 1) // 2)
    weights = 1 + 2 * np.cos(2 * np.pi * np.outer(lag, k) / n).sum(1)
    if n % 2 == 0:
        weights += np.cos(np.pi * t) * np.cos(np.pi * np.arange(n))
    return weights / n


def series_of(run: Run, method: str, plan: Magnification, device: str = "cpu") -> EmbeddingSeries:
    """The run's embeddings magnified by `method`, "linear" or "phase". Raises RunError for files that are torn."""
    model = load_model(run)
    motion = run.load_motion()
    assert motion is not None, "a run without motion has no series"
    embeddings = _stored(run, model, method, plan, motion.n_timesteps, motion.fps)
    return EmbeddingSeries(embeddings, model, motion.fps, device)


def digest(run: Run, method: str, plan: Magnification) -> str:
    """Return a file name from a digest of everything that the magnified embeddings depend on."""
    own = {k: v for k, v in asdict(plan).items() if k not in ("suppressed", "amplitude_percentile")}
    parts = [_VERSION, model_hash(run.path), method, own | {"method": None}, asdict(PyramidConfig())]
    if plan.of_phase:
        parts.append(plan.of_phase)
    return json_digest(parts)[:20]


def _stored(
    run: Run, model: PaperModel, method: str, plan: Magnification, n_timesteps: int, fps: float
) -> np.ndarray:
    folder, name = run.path / FOLDER, digest(run, method, plan)
    shape = (3 * model.channels, n_timesteps, len(model.points))
    target = folder / f"{name}.f32"
    folder.mkdir(exist_ok=True)
    with _alone(target):
        if len(_finished(target, shape)) < shape[0]:
            _make(run, model, method, plan, fps, target, shape)
    os.utime(target)
    _prune(folder, target)
    return np.memmap(target, np.float32, "r", shape=shape)


@contextmanager
def _alone(target: Path) -> Iterator[None]:
    """Wait for another process that makes the same file: two would write into one."""
    lock = FileLock(target.with_suffix(".lock"))
    try:
        lock.acquire(blocking=False)
    except Timeout:
        warnings.warn(f"waiting for another process that makes {target}", stacklevel=2)
        lock.acquire()
    try:
        yield
    finally:
        give_back(lock)


def _make(
    run: Run,
    model: PaperModel,
    method: str,
    plan: Magnification,
    fps: float,
    target: Path,
    shape: tuple[int, int, int],
) -> None:
    response = plan.response(bins(shape[1], fps), fps)
    part = target.with_suffix(".part")
    checksums = _finished(part, shape)
    if not checksums:
        size = 4 * int(np.prod(shape))
        with part.open("wb") as file:
            file.truncate(size)  # where there is no posix_fallocate
            reserve(file.fileno(), size, part)
    out = np.memmap(part, np.float32, "r+", shape=shape)
    r = model.planes.shape[-1]
    assert method in ("phase", "linear"), method
    masked = plan.suppressed, plan.amplitude_percentile
    magnify = PhaseMagnifier((r, r), response, None, *masked) if method == "phase" else None
    with progress(f"{method}: feature planes", shape[0], unit="planes", start=len(checksums)) as update:
        for i in range(len(checksums), shape[0]):
            k, channel = divmod(i, model.channels)
            video = plane_video(run, model, shape[1], k, channel)
            if magnify is not None:
                out[i] = at_points(magnify(video), model.cells, k)
            else:
                out[i] = magnified_series(at_points(video, model.cells, k), response)
            out.flush()
            checksums.append(zlib.crc32(out[i]))
            write_json(part.with_suffix(".json"), {"checksums": checksums})
            update(i + 1)
    del out
    rename(part, target)


def _finished(file: Path, shape: tuple[int, int, int]) -> list[int]:
    """Return the checksums of finished channels; [] without a file, or if they belong to another one."""
    try:
        checksums = read_formed(file.with_suffix(".json"), {"checksums": [int]})["checksums"]
        if file.stat().st_size != 4 * int(np.prod(shape)) or len(checksums) > shape[0]:
            return []
    except (OSError, ValueError):
        return []
    stored = np.memmap(file, np.float32, "r", shape=shape)
    is_same = all(zlib.crc32(channel) == wanted for channel, wanted in zip(stored, checksums, strict=False))
    return checksums if is_same else []


def at_points(video: np.ndarray, cells: TouchedCells, k: int) -> np.ndarray:
    """Return [T, N] a plane's video [T, R, R] at the points, by their bilinear weights on plane k."""
    flat = video.reshape(len(video), -1)
    where = cells.dense[cells.index[k]] - k * cells.resolution**2
    total = np.zeros((len(video), len(where)), np.float32)
    for j in range(4):
        total += flat[:, where[:, j]] * cells.weight[k, :, j]
    return total


def _prune(folder: Path, keep: Path) -> None:
    """Remove all but the latest, and files of killed jobs of other requests."""
    for suffix in (".f32", ".part"):
        files = sorted(folder.glob(f"*{suffix}"), key=lambda f: f.stat().st_mtime, reverse=True)
        for file in files[_KEPT:]:
            if file != keep:
                file.with_suffix(".json").unlink(missing_ok=True)
                with suppress(PermissionError):  # on Windows, while another process reads it
                    file.unlink()


def _check(configs: Mapping[str, Any]) -> None:
    checked_space(configs["space"])
    base_config(configs["space"], checked(configs["paper"]))


def _fit(run: Run, capture: Capture, configs: Mapping[str, Any], device: str) -> None:
    """Base Gaussians, space triplane, motion triplanes. space.safetensors is the scene at rest at every stage."""
    config, images = configs["paper"], load_images(capture)
    if config.difference and capture.kind.moving:
        warnings.warn(
            "the camera moves: phase 2 compares pictures, since no picture shows the same view at rest",
            stacklevel=2,
        )
        config = replace(config, difference=False)
    if not has_model(run):
        views = first_views(capture, images)
        if not run.has_space:
            train_space(run, views, capture.points, base_config(configs["space"], config), device)
        train_triplane(run, run.load_space(), views, config, device)
    model = load_model(run)
    if not run.has_motion:
        run.save_space(model.rest(), {})  # in place of the base Gaussians; the same again after a kill
    if capture.n_timesteps > 1:
        train_timesteps(run, model, capture, images, config, device)


def _poses(run: Run, method: str, plan: Magnification, device: str) -> Poses:
    series = series_of(run, method, plan, device)
    return Poses(series.at, series.n_timesteps, series.fps)


PRESET = Preset(
    # `space` is the fit of the base Gaussians, by L1
    defaults={"space": SpaceConfig(l2=0.0), "paper": PAPER},
    methods=("phase", "linear", "modal"),
    check=_check,
    is_complete=has_model,
    fit=_fit,
    poses=_poses,
)
TUNED = replace(
    PRESET, defaults={**PRESET.defaults, "paper": PAPER_TUNED}, methods=("linear", "phase", "modal")
)
