"""Resolution from coarse to fine: which size of the pictures an iteration sees, and how many Gaussians it may have."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.progress import progress
from tg4mm.fit.space import density
from tg4mm.fit.space.config import SpaceConfig, checked
from tg4mm.fit.space.targets import RestViews

LONGEST = 600  # pixels of the longer side of the coarsest pictures, unless levels are asked for
LAST = 0.7  # share of the iterations after which density control ends
CAUGHT_UP = 0.35  # share of a level's iterations by which its number of Gaussians is reached
# The same of a level that begins with half of its Gaussians: they are there soon, and have longer to settle
FINE_LAST, FINE_CAUGHT_UP = 0.4, 0.2
SPARSE = 1200  # pixels of the longer side of the dataset's pictures, up to which iterations see every pixel
MOST_SPACING = 3  # pixels
SMALLEST = 16  # pixels of the shorter side: of coarser pictures nothing is learnt


@dataclass(frozen=True)
class Level:
    """Iterations that see pictures of one size."""

    shrink: int  # pixels of the dataset's pictures across one of this level's
    begin: int  # first iteration
    end: int  # the one after the last
    max_gaussians: int
    caught_up: float  # iteration by which a start far below that number has reached it
    until: float  # iteration, before which density control goes on
    spacing: int  # from one pixel that an iteration sees to the next, across and down


def automatic(size: tuple[int, int]) -> int:
    """Return the number of levels for pictures of (width, height)."""
    count = 1
    while max(size) >> (count - 1) > LONGEST:
        count += 1
    return count


def check_levels(count: int, size: tuple[int, int]) -> None:
    """Raise Tg4mmError if the coarsest of so many levels is too small to show anything."""
    width, height = (n >> (count - 1) for n in size)
    if count > 1 and min(width, height) < SMALLEST:
        raise Tg4mmError(
            f"setting space.levels is {count}: pictures of {size[0]}×{size[1]} would be {width}×{height} at the "
            f"coarsest, expected at least {SMALLEST} pixels; give fewer"
        )


def resolved(config: SpaceConfig, views: RestViews) -> SpaceConfig:
    """The settings with what follows from the data filled in. Raises Tg4mmError on a value out of range."""
    config = checked(config)
    count = config.levels or automatic(views.size)
    check_levels(count, views.size)
    covered = float(views.alpha.sum() / len(views.alpha))
    iterations = int(np.clip(150 * covered ** (1 / 3), 1_000, 30_000))
    most = int(np.clip(200 * math.sqrt(covered), 2_000, 500_000))
    return replace(
        config,
        iterations=config.iterations or (iterations if count == 1 else iterations // 2),
        max_gaussians=config.max_gaussians or most,
        levels=count,
    )


def levels(config: SpaceConfig, size: tuple[int, int]) -> tuple[Level, ...]:
    """The levels of settings whose zeros are filled in, for pictures of (width, height), the coarsest first.

    The last has half of the iterations, the others share the rest. They end where density control is due, so that no
    round of it adds up the errors of two sizes.
    """
    n, every = config.levels, density.EVERY
    ends = [round((i + 1) / (n - 1) / 2 * config.iterations / every) * every for i in range(n - 1)]
    ends.append(config.iterations)
    return tuple(
        _level(config, size, n - 1 - i, begin, end)
        for i, (begin, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True))
    )


def _level(config: SpaceConfig, size: tuple[int, int], finer: int, begin: int, end: int) -> Level:
    """The level that so many `finer` ones follow."""
    first, most = finer == config.levels - 1, max(4, config.max_gaussians >> finer)
    caught_up = begin + (CAUGHT_UP if first else FINE_CAUGHT_UP) * (end - begin)
    until = begin + (LAST if first else FINE_LAST) * (end - begin) if finer == 0 else end + 1
    return Level(1 << finer, begin, end, most, caught_up, until, _spacing(config, size, finer, most))


def _spacing(config: SpaceConfig, size: tuple[int, int], finer: int, n_gaussians: int) -> int:
    """Return the spacing for about one pixel per Gaussian; 1 with D-SSIM, which compares neighbours, or one level."""
    if config.dssim or config.levels == 1 or max(size) <= SPARSE:
        return 1
    width, height = (n >> finer for n in size)
    return min(max(1, round(math.sqrt(width * height / n_gaussians))), MOST_SPACING)


def level_at(levels: tuple[Level, ...], iteration: int) -> Level:
    """The level that an iteration belongs to."""
    return next(level for level in levels if iteration < level.end)


def work(levels: tuple[Level, ...], iteration: int) -> int:
    """Return the cost of all earlier iterations, in units of one at full picture size."""
    return int(sum(max(0, min(iteration, a.end) - a.begin) / (a.shrink * a.spacing) ** 2 for a in levels))


def turn_of(view: int, iteration: int, n_views: int, spacing: int) -> int:
    """Return which of a view's spacing² pixel grids an iteration uses; the grids take turns."""
    return (view + iteration // n_views) % spacing**2


def sampled(K: Any, picture: Any, spacing: int, turn: int) -> tuple[Any, Any]:
    """Subsample picture [H, W, 3] by `spacing` along rows and columns, starting at the pixel that `turn` selects.

    Also returns the intrinsics [3, 3] with which just these pixels are rendered. Both are arrays, or both tensors.
    """
    if spacing == 1:
        return K, picture
    row, column = divmod(turn, spacing)
    K = K + 0  # a copy
    K[:2] /= spacing
    K[0, 2] += 0.5 - (column + 0.5) / spacing  # pixel centres lie at a half
    K[1, 2] += 0.5 - (row + 0.5) / spacing
    return K, picture[row::spacing, column::spacing]


def shrunk(views: RestViews, by: int) -> RestViews:
    """Pictures of means over squares of `by` pixels, with intrinsics to match.

    What is left over at the right and lower edge is cut off.
    """
    if by == 1:
        return views
    height, width = (n // by for n in views.rgb.shape[1:3])
    rgb = np.empty((len(views.rgb), height, width, 3), np.float32)
    alpha = np.empty(rgb.shape[:3], np.float32)
    with progress("pictures, smaller", len(rgb), "pictures", brief=True) as update:
        for v in range(len(rgb)):
            rgb[v], alpha[v] = _means(views.rgb[v], by), _means(views.alpha[v], by)
            update(v + 1)
    Ks = views.Ks.copy()
    Ks[:, :2] /= by
    return replace(views, rgb=rgb, alpha=alpha, Ks=Ks)


def _means(picture: np.ndarray, by: int) -> np.ndarray:
    """Means of [H, W, …] over squares: rows are added up first, then columns, which seldom lie side by side."""
    height, width = (n // by for n in picture.shape[:2])
    picture = picture[: height * by, : width * by]
    rows = sum((picture[k::by] for k in range(1, by)), start=picture[::by])
    columns = sum((rows[:, k::by] for k in range(1, by)), start=rows[:, ::by])
    return np.asarray(columns * np.float32(1 / by**2), np.float32)
