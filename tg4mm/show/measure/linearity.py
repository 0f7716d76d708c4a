"""How much of a large motion the linear answer lacks, by the pictures themselves.

A sensor's answer is linear in the pictures' changes. How far that holds goes by the texture: blurred edges move by
pixels and stay in proportion, fine speckle does not by half a pixel. So the mean picture is moved by the answer and
compared with the frame: what is left, through the gradients of the moved picture, is what the answer lacks.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter, shift

from tg4mm.capture.pictures import over_white
from tg4mm.show.measure.residuals import AT_ONCE, MeasuredView
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.result.reach import pixel_rows

_FRAMES = 6  # of the largest motion
_LOOKED_AT_PX = 0.3  # less is in proportion in every picture that a camera takes
_EDGE = 0.02  # of the strongest change: pixels that change less do not count
_MARGIN = 6  # pixels around them


def lacking(scene: Prepared, result: SensorResult) -> tuple[float, float, float, float] | None:
    """Largest motion in pixels, the share of it that the answer lacks, the share's deviation, and `other_share`.

    None for a moving camera, and for a motion that is small.
    """
    if scene.is_moving:
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
    """[H, W]: how much a view's pixels tell of a sensor's translations."""
    fields = result.body.motions(scene.means, result.body.weights)[: len(result.series.axes)]
    return np.asarray((np.asarray(view.view.jvp(fields)) ** 2).sum((0, 3)))


def box_of(weights: np.ndarray) -> tuple[tuple[slice, slice], np.ndarray]:
    """The box around the pixels that count, with a margin, and which of its pixels these are [h, w] bool."""
    inside = weights > _EDGE * weights.max()
    down, right = (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
    rows, columns = (slice(max(int(i[0]) - _MARGIN, 0), int(i[-1]) + 1 + _MARGIN) for i in (down, right))
    return (rows, columns), inside[rows, columns]


def missing_share(
    mean: np.ndarray, pictures: np.ndarray, moved: np.ndarray, weights: np.ndarray
) -> tuple[float, float]:
    """Of motions [F, 2] (pixels right and down), how much more pictures [F, H, W, 3] moved along them, as a share.

    mean [H, W, 3] the picture that they moved from; weights [H, W]: where it counts. The second number is the standard
    error over the frames.
    """
    shares = []
    for (x, y), left, columns, _ in _compared(mean, pictures, moved, weights):
        found = np.linalg.lstsq(columns, left, rcond=None)[0][:2]
        shares.append(float(found @ [x, y]) / (x * x + y * y))
    return float(np.mean(shares)), float(np.std(shares, ddof=1) / np.sqrt(len(shares))) if len(
        shares
    ) > 1 else 0.0


def other_share(mean: np.ndarray, pictures: np.ndarray, moved: np.ndarray, weights: np.ndarray) -> float:
    """Of what changes pictures in a region, the share that is no motion of it: something passes, or a light.

    As `missing_share`; the first half of the pictures has the largest motions, the second the smallest, whose leftovers
    are noise. Of each half the median picture counts. From 0 to 1; 0 where nothing but noise changes.
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
        yield (
            motion,
            (picture[box] - there)[own].ravel(),
            columns.reshape(-1, 4),
            (picture[box] - some)[own].ravel(),
        )


_LACKING, _OTHER = 0.03, 0.5  # shares: of the largest motion that is missing; of changes that are no motion
_BLURS_PX = (2.0, 1.0, 0.0, 0.0, 0.0)  # of the passes
_MOST_PIXELS = 400_000  # of a region: a larger one bends, and its passes take minutes
Frames = Callable[[slice], np.ndarray]  # some frames of a region [f, h, w]


def iterated(scene: Prepared, result: SensorResult) -> SensorResult:
    """The result with its motion iterated where more than 3 % of the largest, and two deviations, is missing."""
    if scene.is_moving or scene.capture.kind.sees_depth or len(scene.views) != 1:
        return result
    found = lacking(scene, result)
    if found is None or abs(found[1]) < max(_LACKING, 2 * found[2]) or found[3] > _OTHER:
        return result
    view, series = scene.views[0], result.series
    box, inside = box_of(weights_of(scene, result, view))
    if inside.size > _MOST_PIXELS:
        return result
    rows = pixel_rows(result.body.centre[None], view.frames.viewmat, view.frames.K, scene.observations.size)[
        0
    ][0]
    along = series.axes @ rows.T  # [A, 2] pixels a unit

    def frames(some: slice) -> np.ndarray:
        raw = scene.observations.pictures.strips(view.frames.rows[some].tolist())
        left = over_white(raw(slice(None)), scene.observations.pictures.maximum)
        return np.asarray(left[(slice(None), *box)].mean(-1), np.float32)

    first = series.displacement @ along
    moved = registered(frames, first, inside)
    if moved is None:
        return result
    more = (moved - first) @ np.linalg.pinv(along)
    return replace(result, all_series=(replace(series, displacement=series.displacement + more),))


def registered(frames: Frames, first: np.ndarray, inside: np.ndarray) -> np.ndarray | None:
    """Motions [F, 2] (pixels right and down) that explain a region's frames, from first ones; None: no better.

    inside [h, w] bool: where the region is. Motions are about the mean of the first ones.
    """
    moved, template = np.array(first), np.zeros(inside.shape)
    for k, picture in _each(frames, len(moved)):
        template += _back(picture, moved[k]) / len(moved)
    before = after = 0.0
    for number, blur in enumerate(_BLURS_PX):
        reference, fresh, after = gaussian_filter(template, blur), np.zeros(inside.shape), 0.0
        for k, picture in _each(frames, len(moved)):
            if not number:
                before += _beyond(_back(picture, moved[k]), template, inside)[1]
            step, left = _beyond(_back(gaussian_filter(picture, blur), moved[k]), reference, inside)
            after += left
            moved[k] += step
            fresh += _back(picture, moved[k]) / len(moved)
        moved += first.mean(0) - moved.mean(0)
        template = fresh
    return moved if after < before else None


def _each(frames: Frames, count: int) -> Iterator[tuple[int, np.ndarray]]:
    for start in range(0, count, AT_ONCE):
        yield from enumerate(frames(slice(start, min(start + AT_ONCE, count))), start)


def _back(picture: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """[h, w] shifted back by a motion."""
    return np.asarray(shift(picture, -moved[::-1], order=3, mode="nearest"))


def _beyond(back: np.ndarray, template: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, float]:
    """The motion [2] that a picture has beyond the template, and the square of what light does not explain."""
    down, right = np.gradient(template)
    columns = np.stack([-right[inside], -down[inside], template[inside], np.ones(int(inside.sum()))], -1)
    change = (back - template)[inside]
    products = columns.T @ columns
    fit = np.linalg.solve(products + 1e-9 * np.trace(products) * np.eye(4), columns.T @ change)
    light = columns[:, 2:]
    left = change - light @ np.linalg.lstsq(light, change, rcond=None)[0]
    return fit[:2], float((left**2).sum())
