"""Displacements that an outside method hands in, of the points of the dataset's points3d.ply: docs/protocol.md."""

from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import load_capture
from tg4mm.capture.truth_file import load_truth
from tg4mm.core.untrusted import read_npz
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.sets import BenchSet
from tg4mm.research.bench.truth_files import follow
from tg4mm.research.evaluate.displacement import displacement_figures

FILE, NAME = "displacement.npz", "displacement"
_NOTE = "displacements handed in: errors are over the points of points3d.ply, each with the same weight"


def submitted(folder: Path, data: BenchSet) -> dict[str, Any]:
    """A run's figures as of `measure`, with those of the motion alone; {} where `folder` holds no displacements.

    Raises BenchError for a file that does not hold `displacement` [T, P, 3] alone, finite, and CaptureError for a
    dataset whose truth is damaged.
    """
    file = folder / FILE
    if not file.is_file():
        return {}
    if not file.resolve().is_relative_to(folder.resolve()):
        raise BenchError(f"{file} leads out of its folder, to {file.resolve()}")
    points = load_capture(data.root).points
    if points is None:
        raise BenchError(f"{file}: dataset {data.root} has no points3d.ply that displacements could be of")
    series = _read(file, (data.n_timesteps, len(points.xyz), 3))
    truth = load_truth(data.root, data.fps, data.n_timesteps)
    found = follow(truth, np.asarray(points.xyz, np.float64))
    true = _motion(found.phasors, truth.freqs_hz, data, truth.gains)
    at_once = np.eye(data.n_timesteps, dtype=complex)  # a mode for each timestep
    figures = displacement_figures(
        _motion(series, np.zeros(len(series)), data, at_once), true, np.ones(len(points.xyz))
    )
    return {
        "log": {}, "seconds": dict.fromkeys(("space", "motion", "total")), "rows": {}, "displacement": figures,
        "n_gaussians": None, "mib_on_disk": None, "absent": {}, "notes": [_NOTE],
    }  # fmt: skip


def _read(file: Path, shape: tuple[int, ...]) -> np.ndarray:
    try:
        arrays = read_npz(file)
    except (OSError, ValueError) as error:
        raise BenchError(f"{file} is damaged or not an .npz of plain arrays: {error}") from None
    if set(arrays) != {NAME}:
        raise BenchError(f"{file} holds {', '.join(sorted(arrays)) or 'nothing'}; expected {NAME} alone")
    series = arrays[NAME]
    if series.shape != shape:
        raise BenchError(
            f"{file}: {NAME} has shape {series.shape}, expected {shape}: timesteps, points, axes"
        )
    if not np.issubdtype(series.dtype, np.floating) or not np.isfinite(series).all():
        raise BenchError(f"{file}: {NAME} has type {series.dtype}, expected finite floating-point numbers")
    return series.astype(np.float64)


def _motion(
    phasors: np.ndarray, freqs_hz: np.ndarray, data: BenchSet, gains: np.ndarray | None
) -> ModalMotion:
    still = np.zeros_like(phasors)
    return ModalMotion(freqs_hz, phasors, still, data.fps, data.n_timesteps, gains)
