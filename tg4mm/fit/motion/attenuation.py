"""How much of the motion least squares leaves out because the Jacobian is wrong, and where.

With an error in the regressor, least squares gives too small an answer (attenuation: Fuller, Measurement Error Models,
1987, §1.1), and the Jacobian's fine detail is wrong: few or noisy pictures leave Gaussians at wrong depths and of wrong
sizes. Over a few pixels these errors average out. So the pictures y of each half of the cameras, smoothed by S, are
compared with what the field x' of the other half shows there, whose noise they do not share (an instrument, §1.4):

    gain = Σ_p ⟨S J x'_p, S y⟩ / Σ_p ⟨S J x'_p, S J x_p⟩

One gain serves the scene: ratios of single places agreed less between halves than they differed by noise. It applies
where the pictures show motion, by the denominator's own share of each place, and not to what the prior carries over
to places that stand still.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter

from tg4mm.fit.motion.jacobian.view import blend_sum
from tg4mm.fit.motion.split_half import LEAST, mean_over_neighbours, wiener_shrink
from tg4mm.fit.motion.temporal import TemporalModel

_SMOOTHING_PX = 1.5  # standard deviation
_LARGEST = 3.0  # what is smaller than the pictures show by more was hardly found
_ROUNDS = 24  # of means over neighbours: a place is some hundred Gaussians
_MOVING, _SHARE = 90.0, 0.2  # of this percentile over Gaussians: where half of the gain applies


@dataclass(frozen=True)
class Gain:
    """What to multiply the fields by; 1 where nothing is known of it."""

    ratio: float = 1.0  # of the scene, 1 to 3
    deviation: float = 0.0  # of the ratio, by its two halves
    places: np.ndarray = field(default_factory=lambda: np.ones(1, np.float32))  # [N], or [1] for all

    def squares(self, fields: np.ndarray) -> np.ndarray:
        """[N] squares of the error of fields [R, N, 6] by the gain: its deviation, and the correction."""
        share = (
            self.deviation**2 + (self.ratio - 1) ** 2
        )  # one gain serves all places: it may be right at none
        return share * np.einsum("rnc,rnc->n", *2 * [fields[..., :3].astype(np.float64)])


def gain_of(model: TemporalModel, folds: np.ndarray) -> Gain:
    """Return the gain of fields [2, R, N, 6] of two halves of six cameras or more; one where it is not known."""
    if (
        not model.config.attenuation
        or len(folds) < 2
        or len(model.problem.views) < LEAST
        or not model.separates
        or model.observations.is_flat
    ):
        return Gain()
    _, reliability = wiener_shrink(folds)
    seen, shown, places = np.zeros(2), np.zeros(2), np.zeros((folds.shape[2], 3))
    for p, fold in enumerate(model.folds):
        for v in fold.views.tolist():
            view, y = model.problem.views[v], _smooth(model.images(v))
            own, other = (_smooth(_pictures(model, v, folds[k])) for k in (p, 1 - p))
            other *= reliability[:, None, None, None]
            if model.problem.pixel_weights is not None:
                other *= model.problem.pixel_weights[v][..., None]
            each = np.einsum("rhwc,rhwc->hw", other, own)
            seen[p] += float(np.vdot(other, y))
            shown[p] += float(each.sum(dtype=np.float64))
            places += blend_sum(view, np.repeat(each[..., None], 3, 2))
    if shown.min() <= 0:
        return Gain()
    ratio, halves = float(seen.sum() / shown.sum()), seen / shown
    deviation = float(abs(halves[0] - halves[1]) / 2)
    ratio = float(np.clip(ratio, 1, _LARGEST))
    moves = places[:, 0]
    for _ in range(_ROUNDS):
        moves = mean_over_neighbours(moves, model.problem.graph.knn)
    moves = np.maximum(moves, 0)
    share = moves / (moves + max(_SHARE * float(np.percentile(moves, _MOVING)), 1e-30))
    return Gain(ratio, deviation, (1 + (ratio - 1) * share).astype(np.float32))


def _pictures(model: TemporalModel, v: int, fields: np.ndarray) -> np.ndarray:
    return model.problem.without_nuisance(v, model.problem.views[v].jvp(np.ascontiguousarray(fields)))


def _smooth(pictures: np.ndarray) -> np.ndarray:
    return np.asarray(gaussian_filter(pictures, (0, _SMOOTHING_PX, _SMOOTHING_PX, 0), mode="constant"))
