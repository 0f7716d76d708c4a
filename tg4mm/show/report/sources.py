"""What a report is made of: the model, its scores, what sensors measured, and by how much motion is magnified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_images
from tg4mm.core.pictures.frames import to_bytes
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run
from tg4mm.run.figures_file import read_figures
from tg4mm.show.report.maps import in_band, strongest
from tg4mm.show.result.advice import suggested_alpha
from tg4mm.show.result.read import Reading
from tg4mm.show.weights import blending_weights

METRICS = "metrics.json"
Evaluate = Callable[[Run], dict[str, Any]]  # scores against the ground truth, as metrics.json holds them


@dataclass(frozen=True)
class Model:
    """The trained model and how much each Gaussian counts."""

    gaussians: Gaussians
    motion: ModalMotion | None
    weights: np.ndarray  # [N] blending weight summed over the training views
    main: int  # index of the in-band frequency with most motion
    uncertainty: np.ndarray | None = None  # [N] standard deviation of the displacement, rms, scene units


def load_model(reading: Reading, train: Capture, band: tuple[float, float] | None) -> Model:
    """The run's Gaussians and motion with blending weights. Raises RunError."""
    gaussians, motion = reading.gaussians, reading.motion
    weights = blending_weights(gaussians, train)
    main = strongest(motion, weights, band) if motion is not None else -1
    return Model(gaussians, motion, weights, main, reading.uncertainty.get("displacement"))


def alphas_with_truth(dataset: Path) -> list[int]:
    """The magnifications that the dataset has ground truth for, from its folder names."""
    names = [path.name[1:] for path in (dataset / "magnified").glob("x*") if path.is_dir()]
    return sorted(int(name) for name in names if name.isdigit())


def choose_alpha(
    reading: Reading, noise_px: float | None, wanted: float | None, band: tuple[float, float] | None
) -> tuple[float, str]:
    """`wanted` if given, else what shows the motion well, and a sentence on how it was chosen ("" for `wanted`).

    Where there is ground truth, the largest α of it that is no larger than that. noise_px: the noise's amplitude in the
    pictures, also where no mode stands out of it; None: not known.
    """
    if reading.motion is None:
        return 0.0, ""
    if wanted is not None:
        return float(wanted), ""
    gains = (in_band(reading.motion, band) & reading.motion.is_magnified()).astype(float)
    reach = reading.reach(gains)
    assert reach is not None  # there is a motion
    alpha = suggested_alpha(replace(reach, noise_px=noise_px), reading.capture)
    why = (
        "α was chosen so that the largest motion spans at most 4 % of the picture's shorter side, as long as its noise "
        "stays below a pixel and parts turn by less than half a radian"
    )
    known = [a for a in alphas_with_truth(reading.run.dataset) if a <= alpha]
    if known:
        return float(max(known)), f"{why}; of the magnifications with ground truth the nearest below that."
    return alpha, f"{why}."


def metrics_of(run: Run, evaluate: Evaluate | None) -> dict[str, Any]:
    """RUN/metrics.json where it is newer than the model; else the run is scored now, if its dataset has ground truth.

    {} without ground truth, or without a newer file and `evaluate`. Raises RunError for a file that
    is damaged or of another kind.
    """
    dataset, path = run.dataset, run.path / METRICS
    if not alphas_with_truth(dataset) and not (dataset / "truth" / "motion.npz").exists():
        return {}
    if path.exists() and path.stat().st_mtime >= _made(run):
        return read_figures(path)
    return evaluate(run) if evaluate is not None else {}


def _made(run: Run) -> float:
    files = [run.part_file(name) for name in ("space", "motion")]
    return max(file.stat().st_mtime for file in files if file.exists())


def contact_images(train: Capture, most: int = 30) -> list[np.ndarray]:
    """Pictures of the training cameras at their first timestep, evenly picked, at most `most`: uint8."""
    first = [int(np.flatnonzero(train.camera_ids == i)[0]) for i in dict.fromkeys(train.camera_ids.tolist())]
    picked = [
        first[i] for i in np.unique(np.linspace(0, len(first) - 1, min(most, len(first))).round().astype(int))
    ]
    images = load_images(train.selected(np.array(picked)))
    return [to_bytes(images.rgb(i)) for i in range(len(picked))]
