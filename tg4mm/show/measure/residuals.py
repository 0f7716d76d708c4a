"""Residuals of every frame after the run's motion, pulled back to the Gaussians: the one pass through the pictures.

For frame f of view v, r_f = I_f − Ī_v − J_v M x(τ_f): the frame's change less the part that the run's modes explain.
Kept are Jᵀ W (1 − Q Qᵀ W) r_f of every Gaussian, summed over the views of one clock, separately for two halves of the
data. A sensor's motion is a sum of these over its region and a few products with the Jacobian (`rigid.py`): the
pictures are not needed again. With a rolling shutter, each band of rows has its times (docs/method.md), and sums over a
band are interpolated to the frames' times.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from tg4mm.capture.pictures import over_white
from tg4mm.capture.tracking.row_times import bands_of
from tg4mm.core.even_clock import later
from tg4mm.fit.motion.jacobian.view import ViewJacobian
from tg4mm.fit.motion.nuisance.projection import Nuisance, without
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import Observations, PosedFrames
from tg4mm.fit.motion.split_half import LEAST, chessboard
from tg4mm.show.measure.stored_pass import HALVES

AT_ONCE = 8  # frames
Step = Callable[[int], None]  # called with the number of frames that were done
_SMOOTHING_PX = 1.5
_SAMPLE = 128  # frames for the pixels' noise


def by_band(frames: PosedFrames, height: int, series: np.ndarray) -> np.ndarray:
    """Return functions of the frames' times [R, F] at the times of every band, [B, R, F]."""
    bands = bands_of(frames.readout_s, height)
    return np.stack([later(frames.times_s, series, band.delay_s) for band in bands])


def to_middle(frames: PosedFrames, height: int, rows: np.ndarray, right_hand_sides: np.ndarray) -> None:
    """Interpolate [2, F, N, 6], each Gaussian's at the time of its picture row, to the frames' times, in place.

    rows [N]: pixels from the upper edge.
    """
    for band in bands_of(frames.readout_s, height):
        last = np.inf if band.rows.stop == height else band.rows.stop
        first = -np.inf if band.rows.start == 0 else band.rows.start
        some = np.flatnonzero((rows >= first) & (rows < last))
        if not len(some):
            continue
        for half in right_hand_sides:
            own = half[:, some]
            moved = later(frames.times_s, own.reshape(len(own), -1).T, -band.delay_s).T
            half[:, some] = moved.reshape(own.shape)


@dataclass(frozen=True)
class MeasuredView:
    """One pose: its Jacobian, and its nuisance and pixel weights in each half of the data that it belongs to."""

    view: ViewJacobian
    frames: PosedFrames
    nuisance: Nuisance
    mean: np.ndarray  # [H, W, 3] the picture that changes are relative to
    weights: np.ndarray  # [H, W] float32, per squared pixel value
    halves: tuple[int, ...]  # (0,), (1,) or, by squares of the picture, (0, 1)

    def masked(self, half: int) -> np.ndarray:
        """Return the weights [H, W] in one half."""
        if len(self.halves) == 1:
            return self.weights
        height, width = self.weights.shape
        board = chessboard((width, height))
        return self.weights * (board if half == 0 else 1 - board)

    def models(self) -> Iterator[tuple[int, ObservationModel]]:
        """Yield each half and its observation model."""
        for half in self.halves:
            yield half, ObservationModel.of(self.frames, self.nuisance, self.mean, self.masked(half))


def halves_of(n_views: int) -> list[tuple[int, ...]]:
    """Assign the fixed views of one clock to the halves of the data: alternately, or few views to both, by squares."""
    if n_views >= LEAST:
        return [(k % HALVES,) for k in range(n_views)]
    return [(0, 1)] * n_views


def leftover(
    observations: Observations, view: MeasuredView, shown: np.ndarray, series: np.ndarray
) -> Iterator[tuple[slice, np.ndarray]]:
    """Yield changes less Σ_r series[b, r, f] shown[r] ([R, H, W, 3], J x_r), [f, H, W, 3], a few frames at a time.

    series [B, R, F]: from `by_band`.
    """
    rows, bands = view.frames.rows, bands_of(view.frames.readout_s, len(view.mean))
    for first in range(0, len(rows), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        raw = observations.pictures.strips(rows[some].tolist())
        left = over_white(raw(slice(None)), observations.pictures.maximum) - view.mean
        if len(shown):
            for band, own in zip(bands, series, strict=True):
                flat = shown[:, band.rows].reshape(len(shown), -1)
                part = left[:, band.rows]
                part -= (own[:, some].T.astype(np.float32) @ flat).reshape(part.shape)
        yield some, left


def inverse_noise(energy: np.ndarray) -> np.ndarray:
    """Return weights [H, W] float32 of pixels whose residuals have the mean squares `energy` [H, W].

    One over the variance, smoothed by 1.5 px, plus the picture's mean: no pixel has more than twice the average weight,
    not even one without noise (a cut-out's white).
    """
    smooth = gaussian_filter(energy, _SMOOTHING_PX, mode="reflect")
    level = max(float(smooth.mean()), 1e-12)
    own, unit = packed_weights(1 / (smooth + level))
    return own.astype(np.float32) * unit


def packed_weights(weights: np.ndarray) -> tuple[np.ndarray, np.float32]:
    """Return weights [...] as float16 and the power of two that scales them; packing again changes nothing."""
    unit = np.float32(2.0 ** np.ceil(np.log2(max(float(weights.max()), 1e-30))))
    return (weights / unit).astype(np.float16), unit


def packed_mean(mean: np.ndarray) -> np.ndarray:
    """Return a picture's values, 0 … 1, as int16 in steps of 1 / 65535."""
    return (np.rint(np.clip(mean, 0, 1) * 65535) - 32768).astype(np.int16)


def unpacked_mean(packed: np.ndarray) -> np.ndarray:
    """Return the values of `packed_mean` as float32."""
    return (packed.astype(np.float32) + 32768) / np.float32(65535)


def weighed(
    observations: Observations, view: MeasuredView, shown: np.ndarray, series: np.ndarray, step: Step
) -> MeasuredView:
    """Return the view with pixel weights from its frames' residuals without nuisance."""
    energy = np.zeros(view.mean.shape[:2], np.float32)
    some = sampled(len(view.frames.rows))
    frames = replace(view.frames, rows=view.frames.rows[some], times_s=view.frames.times_s[some])
    series = by_band(view.frames, len(view.mean), series)[..., some]
    for _, left in leftover(observations, replace(view, frames=frames), shown, series):
        own = without(view.nuisance, view.mean, left)
        energy += np.einsum("fhwc,fhwc->hw", own, own) / 3
        step(len(left))
    view.nuisance.release()
    return replace(view, weights=inverse_noise(energy / len(some)))


def sampled(n_frames: int) -> np.ndarray:
    """Draw at most 128 frames: the variance over the some 28 pixels smoothed together is then known to 2 %."""
    return np.sort(np.random.default_rng(0).permutation(n_frames)[:_SAMPLE])


def pull_back(
    observations: Observations,
    view: MeasuredView,
    shown: np.ndarray,
    series: np.ndarray,
    out: np.ndarray,
    step: Step,
) -> None:
    """Add the residuals of the view's frames, pulled back to the Gaussians, to `out` [2, F, N, 6].

    With a rolling shutter they are interpolated from the times of the Gaussians' rows to those of the frames.
    """
    frames, height, models = view.frames, len(view.mean), list(view.models())
    own = np.zeros_like(out) if frames.readout_s else out
    for some, left in leftover(observations, view, shown, by_band(frames, height, series)):
        for half, model in models:
            model.adjoint(left, own[half, some])
        step(len(left))
    view.nuisance.release()
    if frames.readout_s:
        to_middle(frames, height, view.view.splats[:, 1], own)
        out += own


def shown_fields(view: ViewJacobian, fields: np.ndarray) -> np.ndarray:
    """Return the changes of the picture [R, H, W, 3] due to fields [R, N, 6], to first order."""
    if not len(fields):
        return np.zeros((0, *view.transmittance.shape, 3), np.float32)
    return np.array(view.jvp(fields))
