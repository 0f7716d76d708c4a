"""How much of a large motion the linear answer lacks, by the pictures themselves.

A sensor's answer is linear in the pictures' changes. How far that holds goes by the texture: blurred edges move by
pixels and stay in proportion, fine speckle does not by half a pixel. So the mean picture is moved by the answer and
compared with the frame: what is left, through the gradients of the moved picture, is what the answer lacks.
"""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import shift

from tg4mm.capture.pictures import over_white
from tg4mm.show.measure.residuals import MeasuredView
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.result.reach import pixel_rows

_FRAMES = 6  # of the largest motion
_LOOKED_AT_PX = 0.3  # less is in proportion in every picture that a camera takes
_EDGE = 0.02  # of the strongest change: pixels that change less do not count
_MARGIN = 6  # pixels around them


def lacking(scene: Prepared, result: SensorResult) -> tuple[float, float, float, float] | None:
    """Largest motion in pixels, the share of it that the answer lacks, the share's deviation, and `other_share`.

    None for a moving camera, for a flat capture, whose motion is iterated, and for a motion that is small.
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
    """Return by what share pictures [F, H, W, 3] moved more along motions [F, 2], pixels right and down.

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
    """Return the share of the changes in a region that is no motion of it: an occluder, or a light.

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
