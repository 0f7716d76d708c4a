"""Limits of a measurement, a line each; what its linear answer misses of a large motion, and what compression removed.

A sensor's answer is linear in the pictures' changes. The linear range depends on the texture: blurred edges stay
proportional over pixels, fine speckle not over half a pixel. So the mean picture is moved by the answer and compared
with the frame: the residual, through the gradients of the moved picture, gives the missing motion.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import distance_transform_edt, shift

from tg4mm.capture.codec import MeasuredTone, codec_losses
from tg4mm.capture.pictures import over_white
from tg4mm.core.lines import FEWEST
from tg4mm.fit.motion.mode_selection import frequency_notes
from tg4mm.show.maps import pixel_rows
from tg4mm.show.measure.residuals import MeasuredView
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.measure.spectrum import main_is_above

_FRAMES = 6  # of the largest motion
_LOOKED_AT_PX = 0.3  # smaller motion is in the linear range of every camera picture
_EDGE = 0.02  # of the strongest change: pixels that change less do not count
_MARGIN = 6  # pixels around them
_HIDDEN = 0.5  # of a motion: the part hidden by errors of the scene at rest that is reported
_OTHER = 0.5  # of the largest changes: the part not explained by motion of the region that is reported
_LACKING = 0.05  # of the largest motion: the missing part that is reported
# Parts of a region that differ by more from its motion do not move as one, as the test of compression assumes.
_AS_ONE = 0.5
_NEAR_PX = 4.0  # from the Gaussians of a region: nearer pixels belong to it


def lacking(scene: Prepared, result: SensorResult) -> tuple[float, float, float, float] | None:
    """Return the largest motion in pixels, the missing share of it with its deviation, and `other_share`.

    None for a moving camera, for a flat capture, whose motion is iterated, and for a small motion.
    """
    if scene.is_moving or not scene.views:
        return None
    names = [f.name for f in scene.observations.frames]
    v = names.index(result.best_view)
    series = next((s for s in result.all_series if s.clock in ("", names[v])), result.series)
    view, own = scene.views[v], scene.views[v].frames
    if len(own.rows) != len(series.times_s):
        return None
    rows = pixel_rows(result.body.centre[None], own.viewmat, own.K, scene.observations.size)[0][0]
    moved = np.where(series.is_resolved, series.displacement, 0) @ series.axes @ rows.T
    size = np.linalg.norm(moved, axis=1)
    if not size.max(initial=0) > _LOOKED_AT_PX:
        return None
    order = np.argsort(-size)
    largest, least = order[:_FRAMES], order[-_FRAMES:]
    raw = scene.observations.pictures.strips(own.rows[np.concatenate([largest, least])].tolist())
    pictures = over_white(raw(slice(None)), scene.observations.pictures.maximum)
    weights = weights_of(scene, result, view)
    share, deviation = missing_share(view.mean, pictures[: len(largest)], moved[largest], weights)
    other = other_share(view.mean, pictures, moved[np.concatenate([largest, least])], weights)
    return float(size.max()), share, deviation, other


def weights_of(scene: Prepared, result: SensorResult, view: MeasuredView) -> np.ndarray:
    """Return the sensitivity [H, W] of a view's pixels to a sensor's translations."""
    fields = result.body.motions(scene.means, result.body.weights)[: len(result.series.axes)]
    return np.asarray((np.asarray(view.view.jvp(fields)) ** 2).sum((0, 3)))


def box_of(weights: np.ndarray) -> tuple[tuple[slice, slice], np.ndarray]:
    """Return the box around the pixels that count, with a margin, and the mask [h, w] of these pixels in it."""
    inside = weights > _EDGE * weights.max()
    down, right = (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
    rows, columns = (slice(max(int(i[0]) - _MARGIN, 0), int(i[-1]) + 1 + _MARGIN) for i in (down, right))
    return (rows, columns), inside[rows, columns]


def missing_share(
    mean: np.ndarray, pictures: np.ndarray, moved: np.ndarray, weights: np.ndarray
) -> tuple[float, float]:
    """Return the share by which pictures [F, H, W, 3] moved beyond motions [F, 2], pixels right and down.

    mean [H, W, 3]: the picture at rest; weights [H, W] of its pixels. The second number is the standard error over the
    frames.
    """
    shares = []
    for (x, y), left, columns, _ in _compared(mean, pictures, moved, weights):
        found = np.linalg.lstsq(columns, left, rcond=None)[0][:2]
        shares.append(float(found @ [x, y]) / (x * x + y * y))
    error = float(np.std(shares, ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else 0.0
    return float(np.mean(shares)), error


def other_share(mean: np.ndarray, pictures: np.ndarray, moved: np.ndarray, weights: np.ndarray) -> float:
    """Return the share of the changes in a region that its motion does not explain, 0 … 1: an occluder, or a light.

    Arguments: `missing_share`. The first half of the pictures has the largest motions, the second the smallest, whose
    residuals are noise. The median picture of each half counts. 0 where only noise changes.
    """
    before, after = [], []
    for _, left, columns, change in _compared(mean, pictures, moved, weights):
        light = columns[:, 2:]
        before.append(((change - light @ np.linalg.lstsq(light, change, rcond=None)[0]) ** 2).sum())
        after.append(((left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]) ** 2).sum())
    half = len(pictures) // 2
    noise = float(np.median(after[half:]))
    all_of_it, other = float(np.median(before[:half])) - noise, float(np.median(after[:half])) - noise
    if all_of_it < 3 * 1.4826 * float(np.median(np.abs(np.array(after[half:]) - noise))) or all_of_it <= 0:
        return 0.0
    return float(np.clip(other / all_of_it, 0, 1))


def _compared(
    mean: np.ndarray, pictures: np.ndarray, moved: np.ndarray, weights: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Return, for each picture and over the P pixels that count, what the iteration needs.

    The motion [2]; the residual [P] against the mean picture moved by it; the columns [P, 4] of further motion and of
    light; and the difference [P] from the mean picture.
    """
    box, own = box_of(weights)
    some = mean[box].astype(np.float64)
    for picture, motion in zip(pictures, moved, strict=True):
        there = shift(some, (motion[1], motion[0], 0), order=3, mode="nearest")
        slope_down, slope_right = np.gradient(there, axis=(0, 1))
        columns = np.stack([-slope_right[own], -slope_down[own], there[own], np.ones_like(there[own])], -1)
        residual, change = (picture[box] - there)[own].ravel(), (picture[box] - some)[own].ravel()
        yield motion, residual, columns.reshape(-1, 4), change


def limits_of(scene: Prepared, results: Sequence[SensorResult]) -> tuple[str, ...]:
    """Return the limits of the capture, then those of the sensors."""
    out = [*scene.notes, *_of_capture(scene)]
    for result in results:
        out += [*_of_region(result), *_of_sensor(scene, result)]
    sure = {
        round(peak.frequency_hz, 3)
        for r in results
        for peak, orbit in zip(r.spectrum.peaks, r.orbits, strict=True)
        if main_is_above(peak, orbit)
    }
    return tuple(out + frequency_notes(sorted(sure), scene.observations))


def _of_capture(scene: Prepared) -> Iterator[str]:
    if not scene.capture.kind.sees_depth:
        where = (
            "in pixels of its picture" if scene.scale is None else "of the plane that its scale was marked on"
        )
        yield f"a flat capture shows only motion across the line of sight, {where}"
    elif not scene.is_moving and len(scene.views) == len(scene.clocks) == 1:
        yield "one camera hardly shows motion along its line of sight: there waveforms have a much larger ±"
    if len(scene.clocks) > 1:
        yield (
            "the cameras' clocks are independent: peaks combine all cameras, assuming a steady vibration; a "
            "waveform is that of one camera, which hardly shows motion along its line of sight"
        )
    if scene.is_moving:
        yield "slow motion, and common motion of the scene: both are removed as motion of the moving camera"
    if hz := scene.fit.undetermined_hz:
        yield (
            f"which of two parts that move against each other at {', '.join(f'{f:.4g}' for f in hz)} Hz stands still: "
            "every ± is at least as large as the motion"
        )
    if len(scene.means) and not scene.fit.uncertainty:
        yield "the run has no uncertainty of its Gaussians: every ± covers noise only, and shapes include noise"


def _of_region(result: SensorResult) -> Iterator[str]:
    """Yield the limits of a region of a flat capture."""
    if (motion := result.motion) is None:
        return
    if motion.hidden.any():
        yield (
            f"{result.name}: something passes in {int(motion.hidden.sum())} of {len(motion.hidden)} frames; the motion "
            "is interpolated there"
        )
    size = float(np.linalg.norm(motion.whole - np.median(motion.whole, 0), axis=1).max())
    if (other := motion.other_share) > _OTHER:
        yield _unexplained(result, other, size, "something passes, light changes, or parts move differently")
    elif size > 1 and not motion.is_iterated:
        yield (
            f"{result.name} moves by up to {size:.2g} px, and was measured in one step: it may move by more; choose a "
            "smaller region"
        )


def _unexplained(result: SensorResult, share: float, size: float, why: str) -> str:
    return (
        f"{result.name}: {100 * share:.0f} % of its largest changes are not explained by a motion of "
        f"{size:.2g} px: {why}; its numbers may be affected"
    )


def _of_sensor(scene: Prepared, result: SensorResult) -> Iterator[str]:
    if (found := lacking(scene, result)) is not None:
        size, share, deviation, other = found
        if other > _OTHER:
            yield _unexplained(result, other, size, "something passes, or light changes")
        elif share > max(_LACKING, 2 * deviation):
            yield (
                f"{result.name} moves by up to {size:.2g} px, beyond the linear range of its picture: "
                f"the largest motions are underestimated by {100 * share:.0f} %"
            )
    for series in result.all_series:
        is_hidden = (series.false_share > _HIDDEN) & series.is_resolved
        if hidden := [axis for axis, hides in zip(series.labels, is_hidden, strict=True) if hides]:
            where = f" in {series.clock}" if series.clock else ""
            yield (
                f"{result.name}: motion along {', '.join(hidden)}{where} is hardly visible: most of the "
                "change that the scene at rest predicts is missing in the pictures"
            )
    longest = max(len(s.times_s) for s in result.all_series)
    if longest < FEWEST:
        yield f"{result.name}: {longest} frames are too few for a spectrum, {FEWEST} are needed"
    elif not result.spectrum.peaks:
        yield f"{result.name}: nothing stands out of the noise floor"


def with_losses(scene: Prepared, results: Sequence[SensorResult]) -> list[SensorResult]:
    """Add the part of every peak that compression let through; without a video in the run nothing changes."""
    video = scene.video
    if video is None or len(scene.observations.frames) != 1:
        return list(results)
    regions = [_region(scene, result) for result in results]
    tones, uneven = [_tones(result) for result in results], [result.spread > _AS_ONE for result in results]
    found = codec_losses(
        video.path, regions, tones, scene.observations.fps, video.from_s, video.repeats, uneven=uneven
    )
    return [result.with_(losses=tuple(own)) for result, own in zip(results, found, strict=True)]


def _tones(result: SensorResult) -> list[MeasuredTone]:
    """Return the tones of all peaks, pixels right and down."""
    right, up = (result.labels.index(name) for name in ("right", "up"))
    flat = len(result.labels) == 2  # whose axes may be those of a tilted plane
    first, out = float(result.series.times_s[0]), []
    for p in result.spectrum.peaks:
        moved = (p.phasor @ result.axes)[[0, 2]] if flat else p.phasor[[right, up]]
        tone = MeasuredTone(p.frequency_hz, moved * [1, -1] * result.px_per_unit)
        if p.line is not None and p.line.decay_per_s > 0:
            tone = replace(tone, decay_per_s=p.line.decay_per_s, start_s=p.line.from_s - first)
        out.append(tone)
    return out


def _region(scene: Prepared, result: SensorResult) -> np.ndarray:
    """Return the mask [H, W] of a region's pixels, or of those around its Gaussians."""
    if result.mask is not None:
        return result.mask > 0.5 * result.mask.max()
    frame, (width, height) = scene.observations.frames[0], scene.observations.size
    weights = result.body.weights
    means = scene.means[weights > 0.5 * weights.max()]
    x = means @ frame.viewmat[:3, :3].T.astype(np.float64) + frame.viewmat[:3, 3]
    at = (x[:, :2] / x[:, 2:] * np.diag(frame.K)[:2] + frame.K[:2, 2]).astype(int)
    inside = ((at >= 0) & (at < [width, height])).all(1)
    away = np.ones((height, width), bool)
    away[at[inside, 1], at[inside, 0]] = False
    if away.all():
        return ~away
    return np.asarray(distance_transform_edt(away) <= _NEAR_PX)
