"""What a perfect method would score: how far two renders of the same truth differ by their noise alone.

A second render of a few truth pictures, with another seed, lies in `report/reseeded/` under the same relative
paths. Between two pictures with independent noise of variance σ² the squared error is 2σ²; a method without
any noise of its own would have σ², so its PSNR lies 10 log10 2 = 3.01 dB above that of the pair. For SSIM there
is no such rule: the pair's is a lower bound for the noise-free method.

"Nothing moves" is the rest picture of the same camera against the truth at α. The files of a set share one
seed, so what stands still agrees to the last bit there, noise included; no method can know that noise. Where a
rest picture with the other seed exists (`report/reseeded/rest/…`), it gives the row that a method can be
compared with.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.core.metrics import MAX_PSNR_DB, SSIM_WINDOW, psnr, ssim

from ..plan import RESEEDED
from .dataset import SUFFIXES, Dataset, View, read_picture

REST = "rest"  # folder in it with the rest pose: motion magnified by α = −1
NOISE_FREE_DB = 10 * math.log10(2)


@dataclass(frozen=True)
class Pair:
    """A truth picture and the other render of it."""

    alpha: float
    view: View  # of the test camera at α = 0, same timestep
    truth: Path
    other: Path


@dataclass(frozen=True)
class Score:
    """Mean over pairs of pictures."""

    psnr_db: float
    ssim: float | None  # None for pictures smaller than the metric's window
    n: int


@dataclass(frozen=True)
class FloorRow:
    """The scores at one α; None where there are no pictures for it."""

    alpha: float
    pair: Score | None  # two renders of the truth
    still_own_noise: Score | None  # "nothing moves", rest picture with noise of its own
    still: Score | None  # "nothing moves", the set's picture nearest to rest: shares its noise with the truth

    @property
    def perfect_psnr_db(self) -> float | None:
        """PSNR of a method that is exact and free of noise, `MAX_PSNR_DB` at most."""
        if self.pair is None:
            return None
        return min(MAX_PSNR_DB, self.pair.psnr_db + NOISE_FREE_DB)


def find_pairs(dataset: Dataset) -> list[Pair]:
    """The truth pictures that were rendered once more, sorted by α, timestep and camera."""
    found = []
    for view in dataset.views["test"]:
        for alpha in (0.0, *dataset.alphas):
            truth = dataset.magnified(view, alpha) if alpha else view.image
            other = dataset.root / RESEEDED / truth.relative_to(dataset.root)
            if other.is_file() and truth.is_file():
                found.append(Pair(alpha, view, truth, other))
    return sorted(found, key=lambda pair: (pair.alpha, pair.view.timestep, pair.view.name))


def noise_floor(dataset: Dataset, read: Callable[[Path], np.ndarray] = read_picture) -> list[FloorRow]:
    """A row for α = 0 and for each α of the set, each over the pictures that were rendered once more.

    Without a second render the rows hold "nothing moves" alone, over the first test camera at the timestep
    that lies farthest from rest. `read` gives [H, W, 3] in 0..1.
    """
    pairs = find_pairs(dataset)
    rows = []
    for alpha in (0.0, *sorted(dataset.alphas)):
        here = [pair for pair in pairs if pair.alpha == alpha]
        shown = [(pair.view, pair.truth) for pair in here] or _strongest(dataset, alpha)
        second = score(((pair.truth, pair.other) for pair in here), read)
        own = _still(dataset, shown, _other_rest, read)
        shared = _still(dataset, shown, _rest, read)
        rows.append(FloorRow(alpha, second, own, shared))
    return rows


def score(
    pairs: Iterable[tuple[Path, Path]], read: Callable[[Path], np.ndarray] = read_picture
) -> Score | None:
    """Mean PSNR and SSIM over pairs (truth, picture); None for no pairs."""
    values = [_compare(read(truth), read(other)) for truth, other in pairs]
    if not values:
        return None
    similar = [s for _, s in values if s is not None]
    return Score(
        float(np.mean([p for p, _ in values])), float(np.mean(similar)) if similar else None, len(values)
    )


def _compare(truth: np.ndarray, other: np.ndarray) -> tuple[float, float | None]:
    truth, other = np.clip(truth, 0.0, 1.0), np.clip(other, 0.0, 1.0)
    small = min(truth.shape[:2]) < SSIM_WINDOW
    return psnr(other, truth), None if small else ssim(other, truth)


def _still(
    dataset: Dataset,
    shown: list[tuple[View, Path]],
    rest_of: Callable[[Dataset, View], Path | None],
    read: Callable[[Path], np.ndarray],
) -> Score | None:
    pairs = [(truth, rest_of(dataset, view)) for view, truth in shown]
    return score([(truth, rest) for truth, rest in pairs if rest not in (None, truth)], read)


def _strongest(dataset: Dataset, alpha: float) -> list[tuple[View, Path]]:
    at = dataset.at("test", dataset.timesteps_by_strength()[0])[:1]
    files = [(view, dataset.magnified(view, alpha) if alpha else view.image) for view in at]
    return [(view, path) for view, path in files if path.is_file()]


def _rest(dataset: Dataset, view: View) -> Path | None:
    """The picture of the same camera that is nearest to rest; none from a camera that moves."""
    rest = next((v for v in dataset.at("test", dataset.nearest_to_rest()) if v.name == view.name), None)
    if rest is None or not np.allclose(rest.camera_to_world, view.camera_to_world, atol=1e-9):
        return None
    return rest.image if rest.image.is_file() else None


def _other_rest(dataset: Dataset, view: View) -> Path | None:
    base = dataset.root / RESEEDED / REST / f"{view.timestep:03d}" / view.split / view.name
    return next((p for s in SUFFIXES if (p := base.with_name(base.name + s)).is_file()), None)
