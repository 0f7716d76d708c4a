"""What all halves of the data get wrong alike: errors of the model, which grow with the motion and are no noise.

The run says of every Gaussian how uncertain its motion is (docs/method.md, "Uncertainty"): by what motion leaves of
the pictures, and by how much it varies among neighbours. A sensor averages over its region and fits nothing but a
rigid motion, so half of that is left along each axis: a number from a generated set with exact truth
(docs/measure.md). Beside it stands what the halves differ by in proportion to the motion. An error of the model
spreads over directions as noise would: a single camera's sight takes it up many times over. Which part stands still
before a moving camera is one question for the whole region: that error stays whole, and where the run does not tell it,
is as large as the motion.
"""

from dataclasses import replace

import numpy as np

from tg4mm.show.measure.rigid import Body
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.series import Series

OF_UNCERTAINTY = 0.5
_MOST = 1.0  # of the motion


def with_model_error(series: Series, body: Body, scene: Prepared) -> Series:
    """The series with `model_share` and with it in `deviation`: σ_f² = noise² + (share · |u_f|)²."""
    size = np.linalg.norm(np.where(series.is_resolved, series.displacement, 0), axis=1)
    rms = float(np.sqrt((size**2).mean()))
    base = min(shared_error(scene, body) / rms, _MOST) if rms > 0 else 0.0
    base = _MOST if scene.fit.undetermined_hz else base
    least = np.min(series.unit_variance[series.is_observed], initial=np.inf)
    ratio = np.sqrt(np.where(series.is_observed, series.unit_variance, 0) / least)
    share = np.minimum(np.hypot(base * ratio, series.model_share), np.maximum(ratio, 1))
    share = np.hypot(share, np.where(series.is_observed, series.false_share, 0))
    deviation = np.sqrt(series.noise**2 + (share * size[:, None]) ** 2)
    return replace(series, model_share=share, deviation=deviation)


def shared_error(scene: Prepared, body: Body) -> float:
    """Scene units rms, along one axis: by the run's uncertainty of the region's Gaussians; 0 where it has none."""
    known = _along_an_axis(scene)
    if known is None:
        return 0.0
    ground = scene.fit.uncertainty.get("ground", np.zeros(1))
    return float(np.hypot(OF_UNCERTAINTY * _rms(scene, body, known), _rms(scene, body, ground)))


def _rms(scene: Prepared, body: Body, values: np.ndarray) -> float:
    """Over what is seen of a region, of values [N]."""
    seen = body.weights * scene.seen
    return float(np.sqrt((seen @ np.broadcast_to(values.astype(np.float64) ** 2, seen.shape)) / seen.sum()))


def _along_an_axis(scene: Prepared) -> np.ndarray | None:
    """[N] standard deviation of every Gaussian along one axis, scene units: of one camera across its sight."""
    found = scene.fit.uncertainty
    if "across_sight" in found:
        return found["across_sight"]
    if not found:
        return None
    of_model = found["displacement"] ** 2 - found.get("ground", np.zeros(1)) ** 2
    return np.asarray(np.sqrt(np.maximum(of_model, 0) / 3))
