"""Initial positions of Gaussians: points3d.ply, SfM, the masks' visual hull, or the cameras' common space."""

import math
import warnings
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tg4mm.capture import SurfacePoints, cameras
from tg4mm.core.errors import CaptureError
from tg4mm.fit.space.config import INITS
from tg4mm.fit.space.targets import RestViews

FEWEST_SFM = 100  # points; with fewer, texture is too poor to start from them
# Share of the asked-for points to take where many are off the surface: from few, large ones density control goes
# where the pictures are, while thousands of small ones in empty space stay there as haze.
SHARE = {"hull": 0.2, "random": 0.1}
FEWEST = 100  # points taken if asked for, whatever the share
HULL_GRID = 144  # cells along the longest side of the hull's box
DEPTH = 3.0  # cells that a cell may lie behind the nearest one in its place and still be in sight
SEEN = 0.5  # share of the views of the hull's best-seen point that must see the others


@dataclass(frozen=True)
class InitialPoints:
    """Coloured points, with a spacing that sets the size of each point's Gaussian."""

    xyz: np.ndarray  # [M, 3] float32, scene units
    rgb: np.ndarray  # [M, 3] float32 in 0..1
    spacing: np.ndarray  # [M] float32, scene units, rms distance to the three nearest
    source: str  # "points", "hull" or "random"; with "sfm", also how many points that found


def working_box(views: RestViews) -> tuple[np.ndarray, float]:
    """Centre [3] and half side (scene units) of the cube that the cameras look at together."""
    return cameras.working_box(views.viewmats, views.Ks, views.size)


def _project(xyz: np.ndarray, views: RestViews, v: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixel columns, rows (clipped into the image) and a mask of what lies inside the image of view v."""
    width, height = views.size
    cam = xyz @ views.viewmats[v, :3, :3].T + views.viewmats[v, :3, 3]
    z = np.maximum(cam[:, 2], 1e-6)
    u = np.floor(cam[:, 0] / z * views.Ks[v, 0, 0] + views.Ks[v, 0, 2]).astype(np.int64)
    w = np.floor(cam[:, 1] / z * views.Ks[v, 1, 1] + views.Ks[v, 1, 2]).astype(np.int64)
    inside = (cam[:, 2] > 1e-6) & (u >= 0) & (u < width) & (w >= 0) & (w < height)
    return np.clip(u, 0, width - 1), np.clip(w, 0, height - 1), inside


def in_hull(xyz: np.ndarray, views: RestViews, masks: np.ndarray) -> np.ndarray:
    """Return where enough views see the point, and none of them sees background there.

    Enough: a share SEEN of what the best-seen point of the hull has. Before each camera lies a space that few others
    see, and whose silhouette therefore cuts nothing away.
    """
    hull, seen = np.ones(len(xyz), bool), np.zeros(len(xyz), np.int64)
    for v in range(len(masks)):
        u, w, inside = _project(xyz, views, v)
        hull &= masks[v, w, u] | ~inside
        seen += inside
    return hull & (seen >= max(1.0, SEEN * seen[hull].max(initial=0)))


def _grid(low: np.ndarray, high: np.ndarray, cells: int) -> tuple[np.ndarray, float, tuple[int, int, int]]:
    step = float((high - low).max()) / cells
    counts = np.maximum(np.ceil((high - low) / step).astype(int), 1)
    axes = [low[k] + (np.arange(counts[k]) + 0.5) * step for k in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return points.astype(np.float32), step, (int(counts[0]), int(counts[1]), int(counts[2]))


def hull_shell(views: RestViews) -> tuple[np.ndarray, float] | None:
    """Cells [S, 3] on the shell of the alpha masks' visual hull, and their size; None if the masks cut nothing away.

    A coarse grid over the working box finds the hull's box, a fine one its shell: cells inside with a neighbour
    outside. Of those, the cells that some view sees: what is below an object seen from above alone would be wasted.
    """
    masks = views.alpha > 0.5
    if masks.all() or not masks.any():
        return None
    grown = masks.copy()  # a coarse cell must not miss thin parts between its samples
    for shift in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        grown |= np.roll(masks, shift, axis=(1, 2))
    centre, half = working_box(views)
    coarse, step, _ = _grid(centre - half, centre + half, 96)
    kept = coarse[in_hull(coarse, views, grown)]
    if len(kept) == 0:
        return None
    fine, step, shape = _grid(kept.min(0) - step, kept.max(0) + step, HULL_GRID)
    hull = np.zeros(np.array(shape) + 2, bool)
    hull[1:-1, 1:-1, 1:-1] = in_hull(fine, views, masks).reshape(shape)
    interior = np.ones(shape, bool)
    for axis in range(3):
        for side in (0, 2):
            cut = [slice(1, -1)] * 3
            cut[axis] = slice(side, side + shape[axis])
            interior &= hull[tuple(cut)]
    shell = fine[(hull[1:-1, 1:-1, 1:-1] & ~interior).ravel()]
    shell = shell[_in_sight(shell, step, views)]
    return (shell, step) if len(shell) else None


def _in_sight(shell: np.ndarray, step: float, views: RestViews) -> np.ndarray:
    """Return [S] bool: some view has no other cell of the shell, each `step` wide, before this one."""
    seen = np.zeros(len(shell), bool)
    for v in range(len(views.rgb)):
        u, w, inside = _project(shell, views, v)
        if not inside.any():
            continue
        z = shell @ views.viewmats[v, 2, :3] + views.viewmats[v, 2, 3]
        # squares of pixels wide enough that none which the hull covers lies between the centres of its cells
        square = max(1, math.ceil(1.5 * step * float(views.Ks[v, 0, 0]) / float(np.median(z[inside]))))
        across = views.size[0] // square + 1
        place = (w // square) * across + u // square
        nearest = np.full(across * (views.size[1] // square + 1), np.inf)
        np.minimum.at(nearest, place[inside], z[inside])
        seen |= inside & (z <= nearest[place] + DEPTH * step)
    return seen


def hull_points(views: RestViews, count: int, rng: np.random.Generator) -> np.ndarray | None:
    """Return up to `count` points [M, 3], each somewhere in a cell of `hull_shell`."""
    found = hull_shell(views)
    if found is None:
        return None
    shell, step = found
    chosen = shell[rng.choice(len(shell), min(count, len(shell)), replace=False)]
    return np.asarray(chosen + rng.uniform(-step / 2, step / 2, chosen.shape), np.float32)


def mean_colours(xyz: np.ndarray, views: RestViews) -> np.ndarray:
    """Mean over the views of the pixel each point falls on: [M, 3] in 0..1, grey where no view sees it."""
    total, count = np.zeros((len(xyz), 3)), np.zeros(len(xyz))
    for v in range(len(views.rgb)):
        u, w, inside = _project(xyz, views, v)
        inside = inside & ~np.isnan(views.rgb[v, w, u, 0])  # where a mask leaves nothing
        total += np.nan_to_num(views.rgb[v, w, u]) * inside[:, None]
        count += inside
    return np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], 0.5).astype(np.float32)


def sfm_points(views: RestViews, seed: int) -> tuple[SurfacePoints | None, int]:
    """Points triangulated with the known cameras, and how many were found.

    None instead of the points, with a warning, where they are fewer than FEWEST_SFM. Raises Tg4mmError without
    pycolmap.
    """
    from tg4mm.capture.sfm import TriangulationConfig, triangulate_views

    points = triangulate_views(views, TriangulationConfig(seed=seed))
    if len(points) >= FEWEST_SFM:
        return points, len(points)
    warnings.warn(
        f"structure from motion found {len(points)} points, fewer than {FEWEST_SFM}: texture is too poor; "
        "starting from the visual hull, or from random points where there is none",
        stacklevel=2,
    )
    return None, len(points)


def initial_points(
    views: RestViews, points: SurfacePoints | None, kind: str, count: int, rng: np.random.Generator
) -> InitialPoints:
    """Choose and thin the initial points: `count` at most, SHARE of it from sources in it. `kind` is one of INITS.

    "sfm" falls back, with a warning, on the hull and then on random points where it finds too few.

    Raises CaptureError where the asked-for source is not there.
    """
    if kind not in INITS:
        raise CaptureError(f"init is {kind!r}, expected {', '.join(INITS)}")
    if kind == "points" and points is None:
        raise CaptureError("init is 'points', but the dataset has no points3d.ply")
    note = ""
    if kind == "sfm":
        points, n_sfm = sfm_points(views, int(rng.integers(1 << 31)))
        note = f" ({n_sfm} points)" if points is not None else f" (sfm found {n_sfm} points)"
    xyz, rgb, source = _chosen(views, points, kind, count, rng)
    if len(xyz) < 4:
        raise CaptureError(f"initialisation from {source} found {len(xyz)} points, at least 4 are needed")
    distance, _ = cKDTree(xyz).query(xyz, k=4)
    spacing = np.sqrt(np.mean(distance[:, 1:] ** 2, axis=1)).astype(np.float32)
    return InitialPoints(xyz, rgb.astype(np.float32), np.maximum(spacing, 1e-6), source + note)


def _chosen(
    views: RestViews, points: SurfacePoints | None, kind: str, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, str]:
    """Places, colours and name of the first source that `kind` allows and the data have."""
    if points is not None and kind in {"auto", "points", "sfm"}:
        chosen = rng.choice(len(points.xyz), min(count, len(points.xyz)), replace=False)
        xyz, rgb = points.xyz[chosen].astype(np.float32), points.rgb[chosen] / np.float32(255)
        return xyz, rgb, "sfm" if kind == "sfm" else "points"
    if kind in {"auto", "sfm", "hull"}:
        hull = hull_points(views, _thinned(count, "hull"), rng)
        if hull is not None:
            return hull, mean_colours(hull, views), "hull"
        if kind == "hull":
            raise CaptureError("init is 'hull', but the images have no alpha mask that cuts a hull out")
    centre, half = working_box(views)
    xyz = rng.uniform(centre - half, centre + half, (_thinned(count, "random"), 3)).astype(np.float32)
    return xyz, mean_colours(xyz, views), "random"


def _thinned(count: int, source: str) -> int:
    return min(count, max(FEWEST, round(SHARE[source] * count)))


def extent_of(xyz: np.ndarray, views: RestViews) -> float:
    """Return the extent of the points [M, 3] from their centre in scene units, at most the cameras' common view.

    Cameras at one place see no distance, and set no limit.
    """
    reach = float(np.linalg.norm(xyz - xyz.mean(0), axis=1).max())
    origins, _ = cameras.optical_axes(views.viewmats)
    if np.ptp(origins, axis=0).max() <= 1e-6 * max(reach, 1e-6):
        return reach or 1.0
    return min(reach, 2 * working_box(views)[1]) or 1.0
