"""What all halves of the data get wrong alike: errors of the model, which grow with the motion and are no noise.

The run says of every Gaussian how uncertain its motion is (docs/method.md, "Uncertainty"): by what motion leaves of
the pictures, and by how much it varies among neighbours. A sensor averages over its region and fits nothing but a
rigid motion, so half of that is left along each axis: a number from a generated set with exact truth
(docs/measure.md). Beside it stands what the halves differ by in proportion to the motion. An error of the model
spreads over directions as noise would: a single camera's sight takes it up many times over.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tg4mm.measure.prepared import Prepared
from tg4mm.measure.rigid import Body
from tg4mm.measure.series import Series

OF_UNCERTAINTY = 0.5
_MOST = 1.0  # of the motion


def with_model_error(series: Series, body: Body, scene: Prepared) -> Series:
    """The series with `model_share` and with it in `deviation`: σ_f² = noise² + (share · |u_f|)²."""
    size = np.linalg.norm(np.where(series.is_told, series.displacement, 0), axis=1)
    rms = float(np.sqrt((size**2).mean()))
    base = 0.0
    if (known := _along_an_axis(scene)) is not None and rms > 0:
        seen = body.weights * scene.seen
        own = float(np.sqrt((seen @ known.astype(np.float64) ** 2) / seen.sum()))
        base = min(OF_UNCERTAINTY * own / rms, _MOST)
    least = np.min(series.unit_variance[series.is_observed], initial=np.inf)
    ratio = np.where(series.is_observed, np.sqrt(series.unit_variance / least), 0)
    share = np.minimum(np.hypot(base * ratio, series.model_share), np.maximum(ratio, 1))
    share = np.hypot(share, np.where(series.is_observed, series.false_share, 0))
    deviation = np.sqrt(series.noise**2 + (share * size[:, None]) ** 2)
    return replace(series, model_share=share, deviation=deviation)


def _along_an_axis(scene: Prepared) -> np.ndarray | None:
    """[N] standard deviation of every Gaussian along one axis, scene units: of one camera across its sight."""
    found = scene.fit.uncertainty
    if "across_sight" in found:
        return found["across_sight"]
    return np.asarray(found["displacement"] / np.sqrt(3)) if found else None
