"""Cells and squares of cells with one motion each, and what is left of it while lines are taken off."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tg4mm.capture.look.baseline import QUANTISED
from tg4mm.capture.look.scene import CellScene
from tg4mm.capture.look.spectra import noise_floor, spectrum, without

SIZES = (1, 2, 4, 8)  # cells a side
_LEAST_SEEN = 1e-3  # of a pool's information that a picture must have
_RANK = float(np.finfo(float).eps)  # of the largest singular value, times the number of pictures
_REDUCED = 1e-6  # of the normal equations' trace, where few pictures are seen


@dataclass
class AggregationWindow:
    """P places of size × size cells; their motion along two axes of their own, M = 2 P columns."""

    size: int  # cells a side
    corner: np.ndarray  # [P, 2] row and column of the first cell
    centre: np.ndarray  # [P, 2] pixels right and down
    axes: np.ndarray  # [P, 2, 2] columns: unit axes, the better known first
    filled: np.ndarray  # [P] share of pictures in which it is seen
    seen: np.ndarray | None  # [F, M] 1 or 0; None: all
    series: np.ndarray  # [F, M] pixels, nuisance taken off
    residual: np.ndarray  # [F, M] lines taken off too
    amplitudes: np.ndarray  # [K, M] spectrum of the residual
    floor: np.ndarray  # [K, M] noise power
    freedom: np.ndarray  # [K]
    raised: np.ndarray  # [K, M] factors of the floor where something wanders
    least: np.ndarray  # [M] noise power of rounding to grey levels

    def __len__(self) -> int:
        return len(self.centre)

    def update(self, times_s: np.ndarray) -> None:
        """Recompute the spectrum and the noise floor of the residual."""
        self.amplitudes = spectrum(self.residual, times_s)[1]
        floor, self.freedom = noise_floor(np.abs(self.amplitudes) ** 2)
        self.floor = floor * self.raised

    @property
    def sure_floor(self) -> np.ndarray:
        """Return [K, M]: the noise floor, no lower than that of rounding."""
        return np.maximum(self.floor, self.least)

    def statistics(self) -> np.ndarray:
        """Return power over noise [K, P], summed over both axes; without motion half of χ² of 4 degrees of freedom."""
        ratio = np.abs(self.amplitudes) ** 2 / self.floor
        return np.asarray(ratio.reshape(len(ratio), -1, 2).sum(2))

    def fitted(self, columns: np.ndarray, series: np.ndarray, which: np.ndarray | None = None) -> np.ndarray:
        """Return coefficients [B, m] of columns [F, B] in series [F, m], the window's columns `which` (None: all)."""
        fit = np.linalg.pinv(columns, rcond=_RANK * max(columns.shape)) @ series
        if self.seen is None:
            return np.asarray(fit)
        for pictures, members in self._alike if which is None else _alike(self.seen[:, which]):
            products = columns[pictures].T @ columns[pictures]
            products += (_REDUCED * np.trace(products) + 1e-9) * np.eye(columns.shape[1])
            fit[:, members] = np.linalg.solve(
                products, columns[pictures].T @ series[np.ix_(pictures, members)]
            )
        return np.asarray(fit)

    @cached_property
    def _alike(self) -> list[tuple[np.ndarray, np.ndarray]]:
        return [] if self.seen is None else _alike(self.seen)

    def in_picture(self, values: np.ndarray, which: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return [..., p, 2] right and down of values [..., 2 p] along the axes of the places `which`."""
        return np.asarray(
            np.einsum("cxa,...ca->...cx", self.axes[which], values.reshape(*values.shape[:-1], -1, 2))
        )


def _alike(seen: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Group the columns of `seen` [F, m] with gaps by the frames in which they are seen."""
    gaps = np.flatnonzero(seen.min(0) == 0)
    if not len(gaps):
        return []
    _, of = np.unique(np.packbits(seen[:, gaps].T > 0, axis=1), axis=0, return_inverse=True)
    order = np.argsort(of.ravel(), kind="stable")
    groups = np.split(gaps[order], np.flatnonzero(np.diff(of.ravel()[order])) + 1)
    return [(np.flatnonzero(seen[:, members[0]]), members) for members in groups]


def pools_of(scene: CellScene) -> list[AggregationWindow]:
    """Return windows of all sizes that fit into the picture; none if no cell is usable."""
    pools = [_pool(scene, size) for size in SIZES if size <= min(scene.grid.rows, scene.grid.columns)]
    return [pool for pool in pools if len(pool)]


def _pool(scene: CellScene, size: int) -> AggregationWindow:
    """The information-weighted mean motion of size × size cells at every place where half of them can be used."""
    grid, seen = scene.grid, scene.seen
    frames = len(scene.times_s)

    def boxes(values: np.ndarray) -> np.ndarray:
        """Return [..., P, k]: sums of values [..., C, k] over a place's cells."""
        a = values.reshape(*values.shape[:-2], grid.rows, grid.columns, values.shape[-1])
        for axis in (-3, -2):
            pad = [(0, 0)] * a.ndim
            pad[axis] = (1, 0)
            a = np.cumsum(np.pad(a, pad), axis)
            last, first = np.arange(size, a.shape[axis]), np.arange(a.shape[axis] - size)
            a = np.take(a, last, axis) - np.take(a, first, axis)
        return np.asarray(a.reshape(*values.shape[:-2], -1, values.shape[-1]))

    count = boxes(scene.usable[:, None].astype(float))[:, 0]
    flat = scene.information.reshape(-1, 4)
    whole = boxes(flat).reshape(-1, 2, 2)
    good = (count >= max(1, size * size / 2)) & (np.linalg.det(whole) > 1e-12)
    weighted = np.einsum("cij,kcj->kci", scene.information, scene.relative) * seen[..., None]
    by_shift = boxes(weighted)[:, good]
    varies = bool((scene.masks.hidden & scene.usable).any())
    information = (
        boxes(seen[..., None] * flat)[:, good].reshape(frames, -1, 2, 2) if varies else whole[good][None]
    )
    determinant = np.linalg.det(information)
    resolved = determinant > _LEAST_SEEN * np.linalg.det(whole[good])
    adjugate = np.stack(
        [information[..., 1, 1], -information[..., 0, 1], -information[..., 1, 0], information[..., 0, 0]], -1
    )
    mean = (
        np.einsum("kcij,kcj->kci", adjugate.reshape(*information.shape), by_shift)
        if varies
        else np.einsum("cij,kcj->kci", adjugate[0].reshape(-1, 2, 2), by_shift)
    )
    motion = mean / np.where(resolved, determinant, 1)[..., None]
    axes = np.linalg.eigh(whole[good])[1][..., ::-1]
    # Where a codec repeats pixels bit for bit no noise is seen, but a shift is known no better than by rounding.
    typical = np.maximum(np.median(scene.series.misfit, 0), QUANTISED)
    rounded = np.linalg.inv(boxes(flat * (typical / QUANTISED)[:, None]).reshape(-1, 2, 2)[good])
    least = 4 / frames * np.einsum("cia,cij,cja->ca", axes, rounded, axes).ravel()
    resolved = np.broadcast_to(resolved, motion.shape[:2])
    along = np.einsum("kci,cij->kcj", np.where(resolved[..., None], motion, 0), axes).reshape(frames, -1)
    gaps = None if resolved.all() else np.repeat(resolved, 2, 1)
    series = without(along, scene.nuisance, gaps)
    size_of = np.trace(scene.information, axis1=1, axis2=2)[:, None]
    centre = boxes(size_of * grid.centres())[good] / boxes(size_of)[good]
    corner = np.stack(np.divmod(np.flatnonzero(good), grid.columns - size + 1), 1)
    empty = np.zeros((0, 0))
    pool = AggregationWindow(
        *(size, corner, centre, axes, resolved.mean(0), None if gaps is None else gaps.astype(float)),
        *(series, series.copy(), empty, empty, np.zeros(0), np.ones((1, 1)), least),
    )
    if len(pool):
        pool.update(scene.times_s)
        pool.raised = np.ones_like(pool.floor)
    return pool
