"""Operating deflection shapes: how every Gaussian moves at the frequencies of peaks, also as animated pictures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from tg4mm.core.files import write_atomic
from tg4mm.core.pictures.decode import to_bytes
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animator
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render

_SAME = 0.75  # of 1 / duration: nearer than this two frequencies are one
_SIGNIFICANT = 2.0  # deviations that a Gaussian's motion must exceed
_MOST = 6
FRAMES = 16  # of a period
_SHOWN_PX = 0.02  # of the picture's width: what the strongest motion is magnified to
_MILLISECONDS = 60  # a frame
_LONGER = 384  # least pixels of the longer side; smaller pictures are enlarged by an integer
_GREY = 0.75  # of the way to grey


@dataclass(frozen=True)
class OperatingShape:
    """Operating deflection shape: the modes' phasors at one frequency, displacement = Re[phasor exp(i 2π f t)]."""

    frequency_hz: float
    phasors: np.ndarray  # [N, 3] complex64, scene units
    is_above: np.ndarray  # [N] bool: exceeds twice the run's deviation


def shapes_of(scene: Prepared, results: Sequence[SensorResult]) -> tuple[OperatingShape, ...]:
    """Return the shapes at the peaks of all sensors, strongest first, where the run's modes move at all."""
    motion = scene.fit.motion
    if motion is None or not len(motion.freqs_hz):
        return ()
    resolution = 1 / scene.observations.duration_s
    pairs = (zip(result.orbits, result.spectrum.peaks, strict=True) for result in results)
    found = sorted(((o.amplitude, p.frequency_hz) for pair in pairs for o, p in pair), reverse=True)
    hz: list[float] = []
    for _, f in found:
        if all(abs(f - other) > _SAME * resolution for other in hz):
            hz.append(f)
    deviation = scene.fit.uncertainty.get("displacement")
    out = []
    for f in hz[:_MOST]:
        phasors = _phasors(scene, f, resolution)
        size = np.sqrt((np.abs(phasors) ** 2).sum(1))
        if not size.any():
            continue
        least = (
            0.0 if deviation is None else _SIGNIFICANT * deviation * np.sqrt(2)
        )  # of amplitudes, not of rms
        out.append(OperatingShape(f, phasors, size > least))
    return tuple(out)


def _phasors(scene: Prepared, frequency_hz: float, resolution: float) -> np.ndarray:
    """Return the sum [N, 3] of modes within three quarters of a bin, since a sinusoid between bins may be in two."""
    motion = scene.fit.motion
    assert motion is not None
    near = np.abs(motion.freqs_hz - frequency_hz) <= _SAME * resolution
    if not near.any():
        return np.zeros((motion.n_gaussians, 3), np.complex64)
    times = scene.clocks[0].times_s
    turn = np.exp(2j * np.pi * np.outer(motion.freqs_hz[near] - frequency_hz, times))
    return motion.selected(near).combined(turn.mean(1))


def write_animations(
    scene: Prepared, shapes: tuple[OperatingShape, ...], out: Path
) -> list[tuple[Path, float]]:
    """Write OUT/shapes/<frequency>Hz.gif of every shape; returns the files and the magnifications (1 + α)."""
    folder, written = out / "shapes", []
    shown = [s for s in shapes if s.is_above.any()]
    if not shown:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    with progress("shapes", len(shown) * FRAMES, "pictures") as update:
        for k, shape in enumerate(shown):
            camera, pixels = _best(scene, shape)
            gain = max(_SHOWN_PX * camera.width / max(pixels, 1e-9), 1.0)
            pictures = []
            for frame, gaussians in enumerate(_period(scene, shape, gain)):
                pictures.append(to_bytes(render(gaussians, camera)))
                update(k * FRAMES + frame + 1)
            path = folder / f"{f'{shape.frequency_hz:.3f}'.replace('.', '_')}Hz.gif"
            write_atomic(path, partial(_write_gif, pictures))
            written.append((path, gain))
    return written


def _period(scene: Prepared, shape: OperatingShape, gain: float) -> Iterator[Gaussians]:
    """Return the Gaussians at each frame."""
    phasors = np.where(shape.is_above[:, None], shape.phasors, 0).astype(np.complex64)[None]
    motion = ModalMotion.of_phasors(np.array([1.0]), phasors, np.zeros_like(phasors), float(FRAMES), FRAMES)
    at = animator(_greyed(scene.gaussians, ~shape.is_above & (np.abs(shape.phasors).sum(1) > 0)), motion)
    return (at(t, gain - 1) for t in range(FRAMES))


def _greyed(gaussians: Gaussians, rows: np.ndarray) -> Gaussians:
    which = torch.from_numpy(rows)
    sh = gaussians.sh.clone()
    sh[which] = (1 - _GREY) * sh[which] + _GREY * sh[which].mean(2, keepdim=True)
    return replace(gaussians, sh=sh)


def _best(scene: Prepared, shape: OperatingShape) -> tuple[Camera, float]:
    """Return the camera in which the shape moves by most pixels, and how many (99th percentile of the visible)."""
    rows = np.flatnonzero(shape.is_above & (scene.seen > 0.5))
    rows = rows if len(rows) else np.flatnonzero(shape.is_above)
    best, most = 0, -1.0
    for k, frames in enumerate(scene.observations.frames):
        across = np.abs(shape.phasors[rows] @ frames.viewmat[:2, :3].T)
        depth = scene.means[rows] @ frames.viewmat[2, :3] + frames.viewmat[2, 3]
        shift = np.linalg.norm(across, axis=1) * frames.K[0, 0] / np.maximum(depth, 1e-6)
        if (pixels := float(np.percentile(shift, 99))) > most:
            best, most = k, pixels
    return Camera.of(scene.observations.frames[best], scene.observations.size), most


def _write_gif(pictures: Sequence[np.ndarray], path: Path) -> None:
    height, width = pictures[0].shape[:2]
    k = -(-_LONGER // max(height, width))
    large = [Image.fromarray(p).resize((k * width, k * height), Image.Resampling.BICUBIC) for p in pictures]
    # one palette, of four phases: one for each picture would take three times as long
    some = Image.fromarray(np.concatenate([np.asarray(p) for p in large[:: max(1, len(large) // 4)]]))
    palette = some.quantize(256, Image.Quantize.MEDIANCUT)
    first, *rest = (p.quantize(palette=palette, dither=Image.Dither.NONE) for p in large)
    first.save(path, "GIF", save_all=True, append_images=rest, duration=_MILLISECONDS, loop=0, disposal=1)
