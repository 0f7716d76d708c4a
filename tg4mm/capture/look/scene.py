"""Analysis of the cells' series before lines are sought: independent motion, occlusion, light, the background."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from tg4mm.capture.codec.loss import coded_change, lacking
from tg4mm.capture.look.baseline import BLOCK, LEAST_INFORMATION, OTHER, QUANTISED
from tg4mm.capture.look.reading import BETWEEN, INTRA, CellSeries, baseline_in, whole_shift
from tg4mm.capture.look.spectra import step, tones_of
from tg4mm.capture.look.zoom import camera_shapes, designs, fitted
from tg4mm.capture.tracking.template import Grid
from tg4mm.core.lines import tone

_BESIDE, _BESIDE_SPREADS = 1.5, 3  # times the baseline misfit, and deviations of its scatter: a mover's rim
_PASSING = 6  # deviations of a cell's own misfit over time, and of key frames' noise over cells
_UNSEEN_NOISE = 4.0  # grey levels², as sensors have: where a codec repeats what rests, its noise is not known
_AS_NEIGHBOURS = 0.5**0.5  # correlation of a cell's shift with its neighbours': they tell half of its motion
_NEIGHBOURS = np.array([[1.0, 1, 1], [1, 0, 1], [1, 1, 1]])[None, None]
_CLUSTER = 0.2  # of a neighbourhood of nine: one cell alone is noise, on the border too
_LOST = 0.03  # share of detail that B-frames lack from which they are treated apart
_FEWESTOTHERS = 24  # pictures that are not B
FEWEST_OF_KIND = 8  # pictures from which a cell's typical misfit is known
_PULLDOWNS = (5, 25)  # frames after which one repeats; half of them, at most, are of two pictures
_COMBED = 12  # frames in which something seems to pass, from which a pulldown is recognised
_STRAY = 0.1  # of a phase's usual number of such frames: fewer count as none
PATTERNS = (2, 3, 4)  # pictures after which a codec's kinds of them repeat, short of key frames
_REGULAR = 0.7  # share of key frames that must be equally far apart
_LONGEST_PATTERN = 1 / 8  # of the pictures: images of a line by a longer one are everywhere
_PARTS, _EXCEPT = 3, 1  # of the picture, down and across, that must show a line of light; all but so many
_IN_PHASE = 0.75  # of the sum of parts' amplitudes that their waves have together
_EVERYWHERE, _SURE = (
    0.4,
    2.0,
)  # of their median amplitude that each must show; deviations of noise that this must have
_AGREES = 1.5  # times the typical ratio of scatter to noise: cells that do not move
_FAR_OFF = 16.0  # times more: cells that no line moves, and that are yet no background


class Light(NamedTuple):
    """A line of the light."""

    hz: float
    deviation_hz: float
    amplitude: float  # relative
    is_banded: bool  # bands run over the picture, as rows are read one after another


@dataclass(frozen=True)
class Masks:
    """Some cells and the time at which they move."""

    core: np.ndarray  # [C] moves by itself: a small rigid shift explains little of it
    moves: np.ndarray  # [C] the same with its rim
    passed: np.ndarray  # [F, C] something else is there for a while
    hidden: np.ndarray  # [F, C] the same with its rim and a few pictures before and after


@dataclass(frozen=True)
class CellScene:
    """Cells' shifts with their information, nuisance and background."""

    series: CellSeries
    masks: Masks
    usable: np.ndarray  # [C]
    information: np.ndarray  # [C, 2, 2] px⁻² of a picture's shift
    nuisance: np.ndarray  # [F, P] columns: constant, trend, kinds of pictures, resting places, light
    light: list[Light]
    lost: float  # share of detail that B-frames lack
    relative: np.ndarray = field(
        default_factory=lambda: np.zeros(0)
    )  # [F, C, 2] shifts less the background's
    whole: np.ndarray = field(default_factory=lambda: np.zeros(0))  # [F, 2] the background's
    shapes: tuple[str, ...] = ()  # of `zoom.py`, that the background follows, subtracted from `relative`
    courses: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))  # [F, m] theirs, px in the corners

    @property
    def grid(self) -> Grid:
        return self.series.grid

    @property
    def times_s(self) -> np.ndarray:
        return self.series.times_s

    @property
    def dt(self) -> float:
        return step(self.times_s)

    @property
    def duration(self) -> float:
        return float(self.times_s[-1] - self.times_s[0]) + self.dt

    @property
    def seen(self) -> np.ndarray:
        """[F, C] bool."""
        return ~self.masks.hidden & self.usable

    @property
    def between(self) -> np.ndarray:
        """[F] bool: B-frames."""
        return np.asarray(self.series.kinds == BETWEEN)

    @cached_property
    def left(self) -> np.ndarray:
        """[C]: the share of a cell's change that its shift leaves, where that stands out of the noise."""
        series = self.series
        baseline = baseline_in(series)
        left, change = (np.maximum(a.mean(0) - baseline.noise, 0) for a in (series.misfit, series.change))
        above = np.log(baseline.typical / baseline.noise)
        stands_out = above > max(np.log(_BESIDE), _BESIDE_SPREADS * baseline.spread)
        return np.where(stands_out, np.minimum(left / np.maximum(change, 1e-12), 1), 0)

    @property
    def patterns(self) -> tuple[int, ...]:
        """Periods of the frames' kinds; that of key frames too, if it is short and regular.

        Empty if all are key frames, unless they may come from a compressed video.
        """
        if (self.series.kinds == INTRA).all():
            return PATTERNS if self.may_be_decoded else ()
        found = dict.fromkeys(PATTERNS)
        for kind in (self.series.kinds == INTRA, ~self.between):
            if 1 < (period := _period(kind)) <= _LONGEST_PATTERN * len(self.times_s):
                found[period] = None
        return tuple(found)

    @property
    def may_be_decoded(self) -> bool:
        """Return whether the frames may come from a compressed video: all key frames, but without noise at rest."""
        return bool((self.series.kinds == INTRA).all()) and baseline_in(self.series).level <= QUANTISED

    @property
    def order_period(self) -> int:
        """Frames from one that is not B to the next, 0 where there are no B-frames in a regular order."""
        return _period(~self.between) if self.between.any() else 0

    @property
    def taken_off(self) -> dict[float, str]:
        """Frequencies with another origin than motion: the order of B-frames, or bands of light."""
        periods = PATTERNS if self.may_be_decoded else (self.order_period,)
        turns = {k / (n * self.dt): "the codec's turns at" for n in periods for k in range(1, n // 2 + 1)}
        return turns | {line.hz: "the light's" for line in self.light if line.is_banded}

    @property
    def coded_change(self) -> float:
        """Return how much a codec may let a small motion grow or fade over the record, as a logarithm."""
        compared = baseline_in(self.series).compared
        return coded_change(self.series.misfit[:, compared], self.series.kinds).most

    @property
    def treats_apart(self) -> bool:
        """Return whether B-frames lack detail and there are enough other frames."""
        return self.lost > _LOST and int((~self.between).sum()) > _FEWESTOTHERS and bool(self.between.any())


def _period(kind: np.ndarray) -> int:
    """Pictures from one of a kind [F] bool to the next, 0 where that is not regular."""
    steps = np.diff(np.flatnonzero(kind))
    period = int(np.bincount(steps).argmax()) if len(steps) > 1 else 0
    return period if period and (steps == period).mean() >= _REGULAR else 0


def scene_of(series: CellSeries, edges: np.ndarray | None = None) -> CellScene:
    """Find masks, light and a first background of all cells that agree with each other.

    edges [C] bool: cells that show the edge of a vibrating object.
    """
    masks = find_masks(series, edges)
    covariance = shift_covariance(series)
    spread = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
    with np.errstate(all="ignore"):
        information = np.linalg.inv(covariance + 1e-9 * np.eye(2) * spread + 1e-12 * np.eye(2))
    usable = ~masks.moves & np.isfinite(information).all((1, 2))
    usable &= information[:, [0, 1], [0, 1]].max(1) > LEAST_INFORMATION
    information = np.where(usable[:, None, None], information, 0)
    gain = np.where(~masks.hidden & usable, series.gain, np.nan)
    nuisance, light = _nuisance(series, gain)
    scene = CellScene(series, masks, usable, information, nuisance, light, _lost(series))
    return against_background(scene, usable)


def shift_covariance(series: CellSeries) -> np.ndarray:
    """[C, 2, 2] px² of one picture's shift."""
    typical = np.maximum(np.median(series.misfit, 0), QUANTISED)
    return np.asarray(series.covariance * typical[:, None, None])


def find_masks(series: CellSeries, edges: np.ndarray | None = None) -> Masks:
    """Find cells that change otherwise than by vibration, always or at times.

    Their misfit stands out of the noise and is most of the change. A vibration leaves a misfit, too: an edge that
    covers the background, terms beyond the series of a shift, points between pixels. But this is a small share of the
    change that its shift explains, however little noise there is. Compression may leave more, but neighbouring cells
    of a vibrating part still move alike; those of a wheel or of leaves do not. Where rest shows no noise, a codec has
    repeated pixels, perhaps before the film was decoded and stored again without loss.
    """
    grid, baseline = series.grid, baseline_in(series)
    own_change = np.maximum(series.change.mean(0) - baseline.noise, 0)
    is_other = _is_most(grid, np.maximum(series.misfit.mean(0) - baseline.noise, 0), own_change)
    core, excess = baseline.stand_out() & is_other, baseline.excess
    if baseline.level <= QUANTISED:
        core &= series.misfit.mean(0) > _UNSEEN_NOISE
    core = core if edges is None else core & ~edges
    if core.any():
        core &= _like_neighbours(series, ~core) < _AS_NEIGHBOURS
    around = ndimage.binary_dilation(grid.picture(core), BLOCK).ravel() & ~series.matched
    typical = typical_by_kind(series)
    relative = series.misfit / typical
    quiet = ~(core | (around & (excess > max(np.log(_BESIDE), _BESIDE_SPREADS * baseline.spread))))
    informative = quiet & baseline.compared
    unlike = (relative > _misfit_limit(relative[:, informative])) & (
        series.misfit > _key_frame_noise(series, informative)
    )
    unlike &= _is_most(grid, np.maximum(series.misfit - typical, 0), np.maximum(series.change - typical, 0))
    clustered = ndimage.uniform_filter(grid.picture(unlike).astype(float), (1, 3, 3), mode="constant")
    passed = unlike & (clustered > _CLUSTER).reshape(unlike.shape) & quiet
    passed &= ~_combed(passed)[:, None]
    hidden = ndimage.binary_dilation(grid.picture(passed), np.ones((7, 3, 3))).reshape(passed.shape)
    hidden |= ~np.isfinite(series.shift).all(2)
    return Masks(core, ~quiet | around | (hidden.mean(0) > 0.5), passed, hidden)


def _like_neighbours(series: CellSeries, still: np.ndarray) -> np.ndarray:
    """[C]: correlation of a cell's shift, over time and axes, with the weighted mean of its eight neighbours'.

    Shifts are relative to the median of the cells `still` [C] bool, less constant and trend.
    """
    shift = np.where(np.isfinite(series.shift), series.shift, 0)
    if still.any():
        shift = shift - np.median(shift[:, still], 1)[:, None]
    slow = np.linalg.qr(np.stack([np.ones_like(series.times_s), series.times_s], 1))[0]
    shift = shift - np.einsum("fp,gp,gcd->fcd", slow, slow, shift)
    weights = 1 / np.maximum(np.trace(shift_covariance(series), axis1=1, axis2=2), 1e-12)
    weighted = series.grid.picture((weights[:, None] * shift).transpose(0, 2, 1))  # [F, 2, rows, columns]
    others = ndimage.convolve(weighted, _NEIGHBOURS, mode="constant").reshape(len(shift), 2, -1)
    others = others.transpose(0, 2, 1)
    sizes = np.sqrt((shift**2).sum((0, 2)) * (others**2).sum((0, 2)))
    return np.asarray((shift * others).sum((0, 2)) / np.maximum(sizes, 1e-30))


def _combed(passed: np.ndarray) -> np.ndarray:
    """[F] bool: frames of two pictures' fields, by a pulldown, where something seems to pass [F, C] in these alone.

    What moves is combed in them. What passes does so in frames of any number.
    """
    frames, out = np.flatnonzero(passed.any(1)), np.zeros(len(passed), bool)
    for period in _PULLDOWNS:
        counts = np.bincount(frames % period, minlength=period)
        mixed = counts > _STRAY * len(frames) / period
        if len(frames) >= max(_COMBED, period) and mixed.sum() <= period // 2 and not counts[~mixed].any():
            out |= np.resize(mixed, len(out))
    return out


def _is_most(grid: Grid, left: np.ndarray, change: np.ndarray) -> np.ndarray:
    """[..., C] bool: cells where the residual of a shift is most of the change, alone and with their neighbours."""
    sums = [
        ndimage.uniform_filter(grid.picture(a), (1,) * (a.ndim - 1) + (3, 3), mode="nearest").reshape(a.shape)
        for a in (left, change)
    ]
    return np.asarray((left > OTHER * change) & (sums[0] > OTHER * sums[1]))


def _key_frame_noise(series: CellSeries, informative: np.ndarray) -> float:
    """Return the noise of key frames that is seldom exceeded, grey levels².

    A codec repeats the noise of a key frame in cells at rest until it codes them again, often with the next key frame:
    the largest of all cells' values then stands for seconds, as a thing would that has come. Where it never codes a
    cell again, the key frame is the mean, and its misfit says nothing.
    """
    some = series.misfit[series.kinds == INTRA][:, informative]
    some = some[some > QUANTISED]
    if not some.size:
        return 0.0
    middle = float(np.median(some))
    return middle + _PASSING * 1.4826 * float(np.median(np.abs(some - middle)))


def _misfit_limit(relative: np.ndarray) -> np.ndarray:
    """[F, 1]: limit of misfits over typical ones [F, C] that noise seldom exceeds; larger in frames coded otherwise."""
    if not relative.size:
        return np.full((len(relative), 1), 1 + _PASSING * 0.1)
    middle = np.maximum(np.median(relative, 1, keepdims=True), 1.0)
    scatter = 1.4826 * np.median(np.abs(relative - middle), 1, keepdims=True)
    always = 1.4826 * float(np.median(np.abs(relative - 1)))
    return np.asarray(middle + _PASSING * np.maximum(scatter, max(0.1, always)))


def typical_by_kind(series: CellSeries) -> np.ndarray:
    """[F, C] grey levels²: the median misfit of each cell in frames of the same kind: key frames have more noise.

    For a kind with few frames, the median over all kinds times the typical ratio of that kind.
    """
    baseline, out = baseline_in(series), np.empty_like(series.misfit)
    every, compared = baseline.typical, baseline.compared
    for kind in np.unique(series.kinds):
        rows = series.kinds == kind
        if rows.sum() >= FEWEST_OF_KIND:
            out[rows] = np.maximum(np.median(series.misfit[rows], 0), QUANTISED)
        else:
            share = np.median(series.misfit[rows][:, compared] / every[compared], 1, keepdims=True)
            out[rows] = np.maximum(every * share, QUANTISED)
    return out


def _lost(series: CellSeries) -> float:
    """Return the share of detail that B-frames lack compared with the others, by their noise."""
    between = series.kinds == BETWEEN
    if min(between.sum(), (~between).sum()) <= FEWEST_OF_KIND:
        return 0.0
    return lacks(series, between, ~between)


def lacks(series: CellSeries, some: np.ndarray, others: np.ndarray) -> float:
    """Return the share of detail that frames `some` [F] bool lack compared with `others`; neither is empty."""
    return lacking(series.misfit[:, baseline_in(series).compared], some, others)


def _nuisance(series: CellSeries, gain: np.ndarray) -> tuple[np.ndarray, list[Light]]:
    """Return the columns of every cell's nuisance and the lines of light.

    Light is a gain of each cell, beside its shift, and is not removed. But bands of light that run over the picture
    have a slope in each cell, which looks like a shift. Encoders quantise B-frames by their distance from the last
    other frame: the resulting changes of brightness are no line of light.
    """
    t = series.times_s / max(float(series.times_s[-1]), 1e-12)
    columns = [np.ones_like(t), t - 0.5, (t - 0.5) ** 2]
    columns += [(series.kinds == k) * 1.0 for k in np.unique(series.kinds)[1:]]
    columns += [(series.place == k) * 1.0 for k in np.unique(series.place)[1:]]
    plain = np.stack(columns, 1)
    light = _light(gain, series, plain)
    if light and (positions := _positions(series.kinds)).any():
        ordered = np.concatenate([plain, positions], 1)
        fewer = _light(gain, series, ordered)
        light = fewer if len(fewer) < len(light) else light
    bands = [tone(series.times_s, line.hz) for line in light if line.is_banded]
    return np.concatenate([plain, *bands], 1), light


def _positions(kinds: np.ndarray) -> np.ndarray:
    """[F, n] columns: the second, third … B-frame in a row."""
    away = position_in_row(kinds)
    enough = [k for k in range(2, int(away.max()) + 1) if (away == k).sum() >= FEWEST_OF_KIND]
    return np.stack([(away == k) * 1.0 for k in enough], 1) if enough else np.zeros((len(kinds), 0))


def position_in_row(kinds: np.ndarray) -> np.ndarray:
    """[F] int: which B-frame in a row each frame is, from 1; 0: none."""
    frames = np.arange(len(kinds))
    return np.asarray(frames - np.maximum.accumulate(np.where(kinds != BETWEEN, frames, 0)))


def _light(gain: np.ndarray, series: CellSeries, nuisance: np.ndarray) -> list[Light]:
    """Return lines of the gain [F, C] common to the complete picture, unlike the effect of an object's motion.

    Nearly all visible parts of the picture show it, in the same phase at the same height.
    """
    level = _median_of(gain)
    found = tones_of(level / level.mean() - 1, series.times_s, nuisance)
    row, column = np.floor(_PARTS * series.grid.centres() / np.array(series.size)).astype(int).T[::-1]
    by_part = [(k, _median_of(gain[:, _PARTS * row + column == k])) for k in range(_PARTS**2)]
    by_part = [(k, part) for k, part in by_part if np.isfinite(gain[:, _PARTS * row + column == k]).any()]
    kept = []
    for hz, deviation, amplitude in found:
        columns = np.concatenate([nuisance, tone(series.times_s, hz)], 1)
        fits = [np.linalg.lstsq(columns, part, rcond=None)[0] for _, part in by_part]
        noise = [np.std(part - columns @ fit) for (_, part), fit in zip(by_part, fits, strict=True)]
        waves = np.array([fit[-2] - 1j * fit[-1] for fit in fits])
        sizes, sure = np.abs(waves), np.array(noise) * np.sqrt(2 / len(level))
        shown = (sizes > _EVERYWHERE * np.median(sizes)) & bool(np.median(sizes) > _SURE * np.median(sure))
        heights = np.array([k // _PARTS for k, _ in by_part])
        alike = sum(abs(waves[heights == h].sum()) for h in range(_PARTS)) / max(sizes.sum(), 1e-30)
        if shown.sum() >= len(by_part) - _EXCEPT and alike > _IN_PHASE:
            kept.append(Light(hz, deviation, amplitude, abs(waves.sum()) < _IN_PHASE * sizes.sum()))
    return kept


def _median_of(gain: np.ndarray) -> np.ndarray:
    """[F]: the median over cells, 1 where none is seen."""
    out = np.ones(len(gain))
    some = np.isfinite(gain).any(1)
    if some.any():
        out[some] = np.nanmedian(gain[some], 1)
    return out


def against_background(scene: CellScene, still: np.ndarray, all_still: bool = False) -> CellScene:
    """Subtract the common shift of the cells `still` [C], and the camera's zoom and roll, from every cell's shift.

    Textured cells are weighted by area: weighted by texture, a vibrating one would be the background. Cells that
    scatter more than their noise about the others' median are left out; all_still: much more.
    """
    shift = np.where(scene.masks.hidden[..., None], 0.0, np.nan_to_num(scene.series.shift))
    if not still.any():
        return replace(scene, relative=shift, whole=np.zeros((len(shift), 2)))
    size = np.trace(scene.information, axis1=1, axis2=2)
    weights = (
        scene.information * np.minimum(1, np.median(size[still]) / np.maximum(size, 1e-9))[:, None, None]
    )
    counts = (scene.seen & still).astype(float)
    places, picture = scene.grid.centres(), scene.series.size
    shapes = camera_shapes(places, picture, weights, counts, shift, scene.nuisance)
    design = designs(places, picture, shapes)
    known = fitted(design, weights, counts, shift)[:, 2:] if shapes else np.zeros((len(shift), 0))
    most = _AGREES * (_FAR_OFF if all_still else 1)
    counts = counts * _agrees(scene, still, shift - np.einsum("cip,kp->kci", design[..., 2:], known), most)
    found = fitted(design, weights, counts, shift)
    relative = shift - np.einsum("cip,kp->kci", design, found)
    return replace(scene, relative=relative, whole=found[:, :2], shapes=shapes, courses=found[:, 2:])


def _agrees(scene: CellScene, still: np.ndarray, shift: np.ndarray, most: float) -> np.ndarray:
    """[C] bool: cells whose scatter, over their noise, is at most so many times that of those that are `still`."""
    covariance = shift_covariance(scene.series)
    first = whole_shift(np.where(still[None, :, None], shift, np.nan), covariance)
    axes = np.linalg.eigh(scene.information)[1]
    along = np.einsum("kci,cia->kca", shift - first[:, None], axes)
    noise = np.einsum("cia,cij,cja->ca", axes, covariance, axes)
    ratio = (1.4826 * np.median(np.abs(along - np.median(along, 0)), 0)) ** 2 / np.maximum(noise, 1e-12)
    return np.asarray((ratio < most * np.median(ratio[still], 0)).all(1))
