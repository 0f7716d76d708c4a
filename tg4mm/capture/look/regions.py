"""Vibrations of drawn regions: the mean shift of each region's cells, and its lines."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from tg4mm.capture.look.baseline import LEAST_INFORMATION
from tg4mm.capture.look.marks import marked
from tg4mm.capture.look.model import LookLine, RegionLook
from tg4mm.capture.look.reading import MEAN_OF
from tg4mm.capture.look.scene import CellScene
from tg4mm.capture.look.spectra import without
from tg4mm.capture.tracking.template import FROZEN, GAIN_ERROR, false_information
from tg4mm.core.errors import RegionError
from tg4mm.core.lines import Line, find_lines
from tg4mm.core.regions import Region

_WHOLE, _HALF = 0.95, 0.5  # of a cell that a region covers
_EDGE = 10.0  # times as uncertain as the best direction: beyond it a direction is not resolved
_SEEN = 0.5  # of a region's information that a picture must show


def region_looks(scene: CellScene, regions: Iterable[Region]) -> tuple[RegionLook, ...]:
    """Return the result for every region. Raises RegionError where no cell lies in it, or none has texture."""
    return tuple(_looked(scene, region) for region in regions)


def _cells(scene: CellScene, region: Region) -> tuple[np.ndarray, bool]:
    """Return [C] bool, and whether all of them lie inside the region."""
    size = scene.grid.size
    share = scene.grid.cut(region.mask(scene.series.size)[None])[:, 0].mean(1)
    if not (share >= _HALF).any():
        raise RegionError(
            f"region {region.name!r} covers no cell of {size}×{size} pixels: draw it larger, or use tg4mm measure"
        )
    whole = share >= _WHOLE
    chosen = whole if (whole & scene.usable).any() else share >= _HALF
    if not (chosen & scene.usable).any():
        why = "moves by itself" if scene.masks.moves[chosen].any() else "has no texture"
        raise RegionError(f"region {region.name!r} {why}: its shift cannot be measured")
    return chosen & scene.usable, bool((share[chosen] >= _WHOLE).all())


def _looked(scene: CellScene, region: Region) -> RegionLook:
    cells, is_inside = _cells(scene, region)
    information, seen = scene.information[cells], scene.seen[:, cells].astype(float)
    whole = information.sum(0)
    values, axes = np.linalg.eigh(whole)
    false = cells.sum() * false_information(scene.grid.size) / min(len(scene.times_s), MEAN_OF)
    values, axes = values[::-1] - false, axes[:, ::-1]
    least = max(LEAST_INFORMATION, FROZEN * false)
    if values[0] <= least:
        raise RegionError(f"region {region.name!r} has no texture: its shift cannot be measured")
    resolved = values > max(values[0] / _EDGE**2, least)
    products = np.einsum("fc,cij->fij", seen, information)
    rows = np.linalg.det(products) > _SEEN**2 * np.linalg.det(whole)
    weighted = np.einsum("fc,cij,fcj->fi", seen, information, scene.relative[:, cells], optimize=True)
    motion = np.linalg.solve(products[rows], weighted[rows][..., None])[..., 0] @ axes[:, resolved]
    series = without(motion, scene.nuisance[rows])
    shown = scene.grid.picture(cells)
    between = scene.between[rows] if scene.treats_apart else None
    found = find_lines(series, scene.times_s[rows], b_frames=between).lines
    lines = [_line(line, axes[:, resolved], region, shown) for line in found]
    remarks = [] if is_inside else ["its cells reach beyond it"]
    if not resolved.all():
        remarks.append(f"an edge: measured along {axes[0, 0]:+.2f} right {-axes[1, 0]:+.2f} up alone")
    lines = marked(lines, 1 / scene.dt, scene.duration, scene.patterns, scene.taken_off, scene.light)
    return RegionLook(region, tuple(lines), float(values[0] ** -0.5), "; ".join(remarks).replace("-", "−"))


def _line(line: Line, axes: np.ndarray, region: Region, cells: np.ndarray) -> LookLine:
    """Along its main direction; axes [2, D] right and down of the series' components."""
    phase = 0.5 * float(np.angle((line.phasor**2).sum()))
    along = np.real(line.phasor * np.exp(-1j * phase))
    amplitude = float(np.linalg.norm(along)) + 1e-12
    share = along / amplitude
    sure = float(np.linalg.norm(share * line.amplitude_deviation))
    right, down = axes @ share
    low, high = region.corners.min(0), region.corners.max(0)
    return LookLine(
        hz=line.hz,
        hz_deviation=line.hz_deviation,
        amplitude_px=amplitude,
        amplitude_deviation_px=float(np.hypot(sure, GAIN_ERROR * amplitude)),
        change=line.change,
        damping=line.damping,
        damping_deviation=line.damping_deviation,
        start_s=line.start_s,
        from_s=line.from_s,
        direction=(float(right), float(down)),
        phase_rad=phase,
        centre_px=region.centre,
        box=(int(low[0]), int(low[1]), int(np.ceil(high[0])), int(np.ceil(high[1]))),
        cells=cells,
        region=cells,
        statistic=line.strength,
        readout_s=None,
        mark="",
    )


def with_lines(looks: tuple[RegionLook, ...], lines: tuple[LookLine, ...]) -> tuple[RegionLook, ...]:
    """Return the results with all lines, one region after the other, replaced."""
    out, at = [], 0
    for one in looks:
        out.append(replace(one, lines=lines[at : at + len(one.lines)]))
        at += len(one.lines)
    return tuple(out)
