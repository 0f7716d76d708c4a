"""Attenuation of least squares by errors of the Jacobian: two tests and one correction.

With an error in the regressor, least squares gives too small an answer (attenuation: Fuller, Measurement Error Models,
1987, §1.1), and its own residual does not show it. The Jacobian's fine detail is wrong: few or noisy pictures leave
Gaussians at wrong depths and of wrong sizes. Both tests use an instrument (§1.4) that does not share these errors.

`PictureGain` uses the slope ∇I of the scene's own picture and the flow f of the fitted motion m: P = −∇I · f contains
nothing of the Jacobian. With data y the ratio ⟨P, y⟩ / ⟨P, J m⟩ is one where m is right and larger where m is too
small.

`gain_of` compares the pictures y of each half of the cameras, smoothed by S over a few pixels so that errors average
out, with what the field x' of the other half shows there, whose noise they do not share:

    gain = Σ_p ⟨S J x'_p, S y⟩ / Σ_p ⟨S J x'_p, S J x_p⟩

One gain serves the scene: ratios of single places agreed less between halves than they differed by noise. It applies
where the pictures show motion, by the denominator's share of each place, and not to what the prior carries over to
places that do not move.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter

from tg4mm.core.memory import Buffers
from tg4mm.fit.motion.jacobian.view import blend_sum, optical_flow
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import LEAST, mean_over_neighbours, wiener_shrink
from tg4mm.fit.motion.temporal import TemporalModel

_SMOOTHING_PX = 1.5  # standard deviation
_LARGEST = 3.0  # what is smaller than the pictures show by more was hardly found
_ROUNDS = 24  # of means over neighbours: a place is some hundred Gaussians
_MOVING, _SHARE = 90.0, 0.2  # of this percentile over Gaussians: where half of the gain applies
LACKING = 1.5  # the ratio from which it is reported: what is missing is half of what was found
_AT_ONCE = 4  # fields whose flow is in memory together


@dataclass(frozen=True)
class Gain:
    """Factor that corrects the fields; 1 if unknown."""

    ratio: float = 1.0  # of the scene, 1 to 3
    deviation: float = 0.0  # of the ratio, by its two halves
    places: np.ndarray = field(default_factory=lambda: np.ones(1, np.float32))  # [N], or [1] for all

    def squares(self, fields: np.ndarray) -> np.ndarray:
        """Return [N] squares of the error of fields [R, N, 6] by the gain: its deviation, and the correction."""
        # one gain serves all places: it may be right at none
        share = self.deviation**2 + (self.ratio - 1) ** 2
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
            moved = (view.jvp(np.ascontiguousarray(folds[k])) for k in (p, 1 - p))
            mine, other = (_smooth(model.problem.without_nuisance(v, pictures)) for pictures in moved)
            other *= reliability[:, None, None, None]
            if model.problem.pixel_weights is not None:
                other *= model.problem.pixel_weights[v][..., None]
            each = np.einsum("rhwc,rhwc->hw", other, mine)
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


def _smooth(pictures: np.ndarray) -> np.ndarray:
    return np.asarray(gaussian_filter(pictures, (0, _SMOOTHING_PX, _SMOOTHING_PX, 0), mode="constant"))


@dataclass
class PictureGain:
    """Sums over the views that were `add`ed."""

    along: float = 0.0  # ⟨P, J m⟩
    seen: float = 0.0  # ⟨P, y⟩

    def add(self, problem: Problem, v: int, fields: np.ndarray, targets: np.ndarray) -> None:
        """Add view v with the fields [R, N, 6] that were fitted to its targets [ρ, H, W, 3]."""
        view, buffers = problem.views[v], Buffers()
        # not the filmed picture's: texture that the scene lacks is in the targets, but in no J m
        down, right = np.gradient(view.over_white, axis=(0, 1))
        mixed = fields if problem.mixing is None else np.tensordot(problem.mixing[v], fields, 1)
        for first in range(0, len(mixed), _AT_ONCE):
            some = np.ascontiguousarray(mixed[first : first + _AT_ONCE], np.float32)
            flow = optical_flow(view, some, buffers)
            carried = problem.without_nuisance(v, -(right * flow[..., :1] + down * flow[..., 1:2]))
            self.along += float(np.vdot(carried, view.jvp(some)))
            self.seen += float(np.vdot(carried, targets[first : first + _AT_ONCE]))

    @property
    def ratio(self) -> float:
        """Return the factor by which the motion should be larger; 1 without evidence."""
        return self.seen / self.along if self.along > 0 else 1.0

    def squares(self, fields: np.ndarray) -> np.ndarray:
        """Return squares [N] of the displacement missing in fields [R, N, 6]; from `LACKING` on a lower bound."""
        lacking = min(abs(self.ratio - 1), LACKING - 1)
        return lacking**2 * np.einsum("rnc,rnc->n", *2 * [fields[..., :3].astype(np.float64)])
