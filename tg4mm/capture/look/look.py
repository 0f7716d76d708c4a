"""A look at a recording: one pass over its pictures, then lines over the background, twice."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage, stats

from tg4mm.capture.look.baseline import BLOCK
from tg4mm.capture.look.compression import with_losses
from tg4mm.capture.look.conversion import conversion_of, with_conversion
from tg4mm.capture.look.marks import marked
from tg4mm.capture.look.model import FlickerLine, GlobalMotion, Look, LookLine, MovingRegion
from tg4mm.capture.look.order import alike_by_position
from tg4mm.capture.look.peaks import CHANCE
from tg4mm.capture.look.place import Placed, cell_numbers, placed
from tg4mm.capture.look.reading import LARGE_CELL, CellSeries, GreyPicture, read_cells
from tg4mm.capture.look.recording import read_recording
from tg4mm.capture.look.regions import region_looks, with_lines
from tg4mm.capture.look.rows import by_light
from tg4mm.capture.look.scene import CellScene, against_background, scene_of
from tg4mm.capture.look.search import PoolLine, Search
from tg4mm.capture.look.spectra import tones_of
from tg4mm.capture.look.zoom import left_of
from tg4mm.capture.sfm.clip import WHOLE, TimeWindow
from tg4mm.capture.stacks import is_stack
from tg4mm.core.lines import Line as CoreLine
from tg4mm.core.lines import alias, find_lines, fit_lines
from tg4mm.core.regions import Region, Regions

_MOVES = 13.3  # χ² of 4 degrees of freedom, 1 %: a cell that a line moves is no background
_MOST = 0.6  # of all cells: then those that move as much as the others are,
_AS_MUCH = 0.2  # of the amplitude that a tenth of them exceeds
_FEW = 3  # cells across a region
_ITS_RIM = 2  # cells from an edge, whose neighbours are left out, to the nearest that is used
_LIGHT_S, _LIGHT = 0.3, 0.02  # seconds that a level is the median of, and a change of it that is reported
_LEAST_STILL = 0.15  # of the usable cells that a background needs
_APART = 2.0  # times the resolution, from a frequency to its mirror image at half the rate
_CLIPPED, _CLIPPED_SHARE = 250, 0.02  # grey levels that are clipped but for noise; share of a cell's pixels
_FEWEST, _LONGEST = 8, 2  # cells × frames of a passing object, and frames that it takes at least


def look(
    video: Path | str,
    fps: float | None = None,
    window: TimeWindow = WHOLE,
    regions: Regions | None = None,
    keep_duplicates: bool = False,
) -> Look:
    """Find vibrations, independently moving objects and changes of light in a recording of a fixed camera.

    video: a video, or a folder of numbered pictures. fps: frames per second, if the file's times are not the
    recording's (slow motion); required for a folder. window: the part of a video to analyse. regions: drawn regions,
    whose lines are estimated separately. keep_duplicates: do not search for duplicate frames. Raises CaptureError if
    the video cannot be decoded or is too short, RegionError for a region without texture.
    """
    path = Path(video)
    drawn = () if regions is None else regions.regions
    series, repeats = read_recording(
        path, fps, window, any(_is_small(region) for region in drawn), keep_duplicates
    )
    if regions is not None:
        regions.check_size(series.size, path)
    found = replace(look_at(series, drawn), repeats=repeats)
    if path.is_dir() or is_stack(path):
        return found
    of_regions = [line for one in found.regions for line in one.lines]
    corrected = with_losses(
        replace(found, lines=(*found.lines, *of_regions)), path, found.rate, window.start_s, repeats
    )
    count = len(found.lines)
    lines = sorted(corrected[:count], key=lambda line: bool(line.mark))
    return replace(found, lines=tuple(lines), regions=with_lines(found.regions, corrected[count:]))


def _is_small(region: Region) -> bool:
    """Return whether a region covers only a few cells of a large picture."""
    return float(np.ptp(region.corners, axis=0).min()) < _FEW * LARGE_CELL


def look_at_pictures(pictures: Iterable[GreyPicture], where: str) -> Look:
    """Return `look`'s result for any pictures of one fixed camera, in order."""
    return look_at(read_cells(pictures, where))


def look_at(series: CellSeries, regions: Sequence[Region] = ()) -> Look:
    """Return `look`'s result for the series of cells."""
    scene = scene_of(series)
    search = Search(scene)
    if (edges := _edges(search)).any():
        scene = scene_of(series, edges)
        search = Search(scene)
    if search.lines:
        moved = _moved(search)
        still = scene.usable.copy()
        still[cell_numbers(search)[moved]] = False
        if moved.any() and still.sum() > _LEAST_STILL * scene.usable.sum():
            scene = against_background(scene, still, all_still=True)
            search = Search(scene)
    converted = conversion_of(scene, search.lines[0].vibration.hz) if search.lines else None
    lines = [one for line in search.lines for one in _lines(search, line)]
    patterns = (*scene.patterns, converted.period) if converted else scene.patterns
    lines = marked(
        lines, 1 / scene.dt, scene.duration, patterns, scene.taken_off, scene.light, _clipped(series)
    )
    lines = with_conversion(lines, converted)
    first = {line.hz: line for line in reversed(lines)}
    lines = [line for line in lines if line is first[line.hz] or not (line.mark or first[line.hz].mark)]
    swings = tuple(swings_of(scene))
    lines = [replace(line, mark=line.mark or left_of(line, swings, scene.duration)) for line in lines]
    found = _result(
        scene, search, swings, sorted(lines, key=lambda line: (bool(line.mark), -line.amplitude_px))
    )
    return replace(
        found, regions=region_looks(scene, regions), conversion=converted.words if converted else ""
    )


def _clipped(series: CellSeries) -> np.ndarray:
    """Return the mask [rows, columns] of cells with clipped highlights in the first picture."""
    share = (series.grid.cut(series.first[None])[:, 0] >= _CLIPPED).mean(1)
    return series.grid.picture(share > _CLIPPED_SHARE)


def _edges(search: Search) -> np.ndarray:
    """[C] bool: cells that seem to move independently, at the frequency of a line beside them or at twice that.

    They show the edge of a vibrating object, which covers and uncovers the background once or twice a period.
    """
    scene, out = search.scene, np.zeros(len(search.scene.grid), bool)
    if not search.lines or not scene.masks.core.any():
        return out
    moving = np.zeros(len(out), bool)
    moving[cell_numbers(search)[_moved(search)]] = True
    touching, near_by = (
        ndimage.binary_dilation(scene.grid.picture(moving), BLOCK, n).ravel() for n in (1, _ITS_RIM)
    )
    known_hz = [n * line.vibration.hz for line in search.lines for n in (1, 2)]
    folded = [alias(hz, 1 / scene.dt) for hz in known_hz]
    for cells, tones in _by_themselves(scene):
        near = (abs(tone[0] - hz) < 1 / scene.duration for tone in tones for hz in folded)
        left, upper, right, lower = scene.grid.box(cells)
        is_thin = min(right - left, lower - upper) <= scene.grid.size  # as an edge is, unlike a body
        if (cells & (near_by if is_thin else touching)).any() and any(near):
            out |= cells
    return out


def _moved(search: Search) -> np.ndarray:
    """[P] bool: cells that a line moves differently from most cells."""
    pool, moved = search.pools[0], np.zeros(len(search.pools[0]), bool)
    for line in search.lines:
        fit = pool.in_picture(line.plain[0])
        deviation = np.einsum("cxa,icx->ica", pool.axes, fit - np.median(fit, 1, keepdims=True))
        basis = line.vibration.columns(search.times)
        precision = 4 / len(search.times) / pool.floor[search.bin_of(line.vibration.hz)].reshape(-1, 2)
        statistic = np.einsum("ica,ij,jca,ca->c", deviation, basis.T @ basis, deviation, precision)
        moves, size = statistic > _MOVES, np.linalg.norm(deviation, axis=(0, 2))
        if moves.mean() > _MOST:
            moves &= size > _AS_MUCH * np.percentile(size[moves], 90)
        moved |= moves
    return moved


def _lines(search: Search, line: PoolLine) -> list[LookLine]:
    """Return a line's entries: where it is largest, then parts that move differently at its frequency."""
    reported = _reported(search, line)
    return [_line(search, line, reported, where) for where in placed(search, line)]


def _line(search: Search, line: PoolLine, reported: CoreLine, where: Placed) -> LookLine:
    grid = search.scene.grid
    cells = where.moving if len(where.moving) else where.region
    return LookLine(
        *(reported.hz, reported.hz_deviation, where.amplitude_px, where.deviation_px),
        reported.change,
        *(reported.damping, reported.damping_deviation, reported.start_s, reported.from_s),
        *(
            (float(where.direction[0]), float(where.direction[1])),
            where.phase_rad,
            where.centre_px,
            grid.box(cells),
        ),
        cells=grid.picture(np.isin(np.arange(len(grid)), cells)),
        region=grid.picture(np.isin(np.arange(len(grid)), where.region)),
        statistic=line.statistic,
        readout_s=None if where.readout is None else where.readout.seconds,
        mark="",
        readout_deviation_s=None if where.readout is None else where.readout.deviation_s,
        between_share=where.between_share,
    )


def _reported(search: Search, line: PoolLine) -> CoreLine:
    """Return the line with all tests of `tg4mm.core.lines`; a steady one if the codec may have caused its change.

    A decay is estimated from frames that keep small motion: the loss of the others would look like damping.
    """
    vibration, scene = line.vibration, search.scene
    series, seen = search.series_of(line)
    alike = alike_by_position(series[seen], search.times[seen], scene.series.kinds[seen], vibration.hz)
    steady = fit_lines(alike.series, search.times[seen], [alike.hz]).lines[0]
    steady.covariance[0, 0] *= alike.wider
    reported = steady
    if vibration.decay_per_s:
        rows = seen & ~scene.between if scene.treats_apart else seen
        rows = rows if _is_off_mirror(vibration.hz, search.times[rows], scene.duration) else seen
        half = max(1 / scene.duration, vibration.decay_per_s / np.pi)
        ends = max(vibration.hz - half, 1 / scene.duration), vibration.hz + half
        found = find_lines(series[rows], search.times[rows], ends=ends, most=1).lines
        reported = found[0] if found and found[0].damping is not None else vibration
    if 0 < abs(reported.decay_per_s) * scene.duration < scene.coded_change:
        return replace(steady, decay_per_s=0.0, change="untold")
    return reported


def _is_off_mirror(hz: float, times_s: np.ndarray, duration_s: float) -> bool:
    """Return whether frames at these times resolve a frequency from its mirror image about half their rate."""
    rate = 1 / float(np.median(np.diff(times_s)))
    apart = abs((2 * hz + rate / 2) % rate - rate / 2)
    return bool(apart > _APART / duration_s)


def _result(
    scene: CellScene, search: Search, swings: tuple[GlobalMotion, ...], lines: list[LookLine]
) -> Look:
    grid, series = scene.grid, scene.series
    cells = max(len(search.pools[0]), 1) if search.pools else 1
    whole = [tone for k in (0, 1) for tone in tones_of(scene.whole[:, k], scene.times_s, scene.nuisance)]
    return Look(
        lines=tuple(lines),
        movers=movers_of(scene),
        light=tuple(FlickerLine(*line[:3]) for line in scene.light),
        whole=tuple(FlickerLine(*tone) for tone in whole),
        hz=search.hz,
        composite=search.composite,
        composite_floor=float(stats.gamma.isf(CHANCE / len(search.hz), 2 * cells) / (2 * cells)),
        moves_by_itself=grid.picture(scene.masks.core),
        hidden=grid.picture(scene.masks.hidden & ~scene.masks.moves),
        usable=grid.picture(scene.usable),
        shift_px=scene.relative.reshape(len(scene.relative), grid.rows, grid.columns, 2),
        whole_px=scene.whole,
        times_s=series.times_s,
        cell_px=grid.size,
        size=series.size,
        smallest=search.smallest(),
        first=series.first,
        without_between=scene.treats_apart,
        images_hz=1 / (scene.order_period * scene.dt) if scene.treats_apart and scene.order_period else 0.0,
        coded_change=scene.coded_change,
        light_readout=by_light(series.row_means, series.times_s),
        swings=swings,
    )


def swings_of(scene: CellScene) -> Iterator[GlobalMotion]:
    """Yield the whole picture's motion besides its shift, zoom and roll, and the light's level where it changes."""
    for shape, course in zip(scene.shapes, scene.courses.T, strict=True):
        away = course - np.median(course)
        tones = tuple(FlickerLine(*tone) for tone in tones_of(course, scene.times_s, scene.nuisance))
        at = int(np.abs(away).argmax())
        yield GlobalMotion(shape, float(np.abs(away).max()), float(scene.times_s[at]), tones)
    rows = np.log(np.maximum(scene.series.row_means, 1.0))
    level = np.median(rows - np.median(rows, 0), 1)
    window = 2 * round(_LIGHT_S / scene.dt / 2) + 1
    smooth = ndimage.median_filter(level, window, mode="nearest")
    if float(np.ptp(smooth)) > _LIGHT:
        steps = np.abs(smooth[window // 2 + 1 :] - smooth[: -(window // 2 + 1)])
        at = int(steps.argmax()) + window // 4
        yield GlobalMotion("light", float(np.expm1(np.ptp(smooth))), float(scene.times_s[at]), ())


def movers_of(scene: CellScene) -> tuple[MovingRegion, ...]:
    """Return independently moving regions, such as wheels and leaves, then passing objects."""
    return (*_all_along(scene), *_passing(scene))


def _all_along(scene: CellScene) -> Iterator[MovingRegion]:
    for cells, tones in _by_themselves(scene):
        hz, deviation, _ = min(tones, key=lambda tone: tone[1], default=(None, None, 0.0))
        yield MovingRegion(
            "moves by itself", scene.grid.box(cells), hz, deviation, 0.0, float(scene.times_s[-1])
        )


def _by_themselves(scene: CellScene) -> Iterator[tuple[np.ndarray, list[tuple[float, float, float]]]]:
    """Yield connected cells [C] bool that move independently, and the lines of their brightness and misfit."""
    labels, _ = ndimage.label(scene.grid.picture(scene.masks.core), BLOCK)
    for k in range(1, labels.max() + 1):
        cells = (labels == k).ravel()
        changes = np.log(scene.series.misfit[:, cells].mean(1) + 1e-9)
        brightness = np.nan_to_num(scene.series.gain[:, cells].mean(1))
        both = (tones_of(y, scene.times_s, scene.nuisance, most=1) for y in (brightness, changes))
        yield cells, [tone for tones in both for tone in tones]


def _passing(scene: CellScene) -> Iterator[MovingRegion]:
    passed, size = scene.grid.picture(scene.masks.passed), scene.grid.size
    labels, _ = ndimage.label(passed, np.ones((3, 3, 3)))
    for k, where in enumerate(ndimage.find_objects(labels), 1):
        times, rows, columns = where
        if (labels[where] == k).sum() >= _FEWEST and times.stop - times.start > _LONGEST:
            box = (columns.start * size, rows.start * size, columns.stop * size, rows.stop * size)
            first, last = scene.times_s[times.start], scene.times_s[times.stop - 1]
            yield MovingRegion("passes", box, from_s=float(first), until_s=float(last))
