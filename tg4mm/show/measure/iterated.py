"""Motion of whole pixels: Gauss-Newton on a sensor's own pixels, where the linear answer lacks a part of it.

Every frame is shifted back by the motion found so far, and the mean of what is shifted back is the template: sharp,
where the mean picture is blurred by the motion. What a frame then has beyond the template, through the template's
slopes and light, is what the motion lacks [Lucas & Kanade 1981; Baker & Matthews 2004]. The first passes are on blurred
pictures, which stay in proportion for longer. Flat captures alone; a small motion keeps its linear answer to the bit.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter, shift

from tg4mm.capture.pictures import over_white
from tg4mm.show.measure.linearity import box_of, lacking, weights_of
from tg4mm.show.measure.residuals import AT_ONCE
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.result.reach import pixel_rows

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
