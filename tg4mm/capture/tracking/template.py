"""Shift of parts of a picture against the mean picture: Lucas–Kanade from six inner products a part and frame.

A part (a cell of a grid, or the pixels of a region) differs from the mean picture M by
d = o + (g − 1) (M − mean M) − g u · ∇M + …: offset o, gain g and shift u are least squares with instruments,
[1, M, ∇ of a smoothed M], which are correlated with the noise of d less than ∇M itself (Bowden & Turkington 1984).
Terms up to third order in u follow by Gauss–Newton steps on the same products; what the motion itself took from the
mean picture (its second and third moments) is subtracted. A turn of the part about its centre is a third unknown on
request.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from scipy import ndimage

# First derivative of 8th order: exact to .1 % at a third of the sampling rate.
_DERIVATIVE = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840.0
_SMOOTH_PX = 1.0  # standard deviation of what smooths the instruments
_LINEAR_PX = 0.03  # up to here third-order terms are below a thousandth
_PLAIN, _UNKNOWN = 1e-3, 1e6  # a cell's squared slopes, grey levels² / px², of no texture at all; px² then
_STEPS = 4  # of Gauss-Newton; the terms beyond third order are larger than what more steps would change
_FURTHEST_PX = 1.0  # where the series in u ends
FROZEN = 10.0  # pictures that a codec's noise may last: so many times less than white noise it averages out
GAIN_ERROR = 0.015  # of a motion: what kernel and series miss
_DIVERGED = 2.0  # times what a simpler answer leaves
_LEAST_GAIN = 0.2  # a darker cell shows something else


class Parts(Protocol):
    """C sets of pixels, of which each moves as one."""

    def __len__(self) -> int:
        """Return C."""
        ...

    def cut(self, pictures: np.ndarray) -> np.ndarray:
        """Return the weighted pixels [C, F, P] float32 of pictures [F, H, W]."""
        ...


@dataclass(frozen=True)
class Grid:
    """Square cells that tile a picture from its upper left corner; the rest at its right and lower edge is left out."""

    rows: int
    columns: int
    size: int  # pixels
    edge: int = 0  # pixels of the picture before the first row and column

    @classmethod
    def of(cls, width: int, height: int, size: int) -> "Grid":
        return cls(height // size, width // size, size)

    def __len__(self) -> int:
        return self.rows * self.columns

    def cut(self, pictures: np.ndarray) -> np.ndarray:
        """Return [C, F, S²] float32 of pictures [F, H, W]."""
        n, size = len(pictures), self.size
        rows, columns = (slice(self.edge, self.edge + n * size) for n in (self.rows, self.columns))
        inside = pictures[:, rows, columns]
        tiles = inside.reshape(n, self.rows, size, self.columns, size).transpose(1, 3, 0, 2, 4)
        return np.ascontiguousarray(tiles, np.float32).reshape(len(self), n, size * size)

    def picture(self, values: np.ndarray) -> np.ndarray:
        """Return [..., rows, columns] of values [..., C]."""
        return values.reshape(*values.shape[:-1], self.rows, self.columns)

    def centres(self) -> np.ndarray:
        """Return [C, 2] pixels right and down."""
        row, column = np.divmod(np.arange(len(self)), self.columns)
        return (np.stack([column, row], 1) + 0.5) * self.size + self.edge

    def box(self, cells: np.ndarray) -> tuple[int, int, int, int]:
        """Left, upper, right and lower edge, pixels, of cells [C] bool or their indices."""
        row, column = np.divmod(np.flatnonzero(cells) if cells.dtype == bool else cells, self.columns)
        edges = (column.min(), row.min(), column.max() + 1, row.max() + 1)
        left, upper, right, lower = (int(edge) * self.size + self.edge for edge in edges)
        return left, upper, right, lower


class Solved(NamedTuple):
    """Shifts, gains and misfits of C parts in F pictures."""

    shift: np.ndarray  # [C, F, 2] pixels right and down, or [C, F, 3] with turns; NaN where a part is dark
    gain: np.ndarray  # [C, F]
    misfit: np.ndarray  # [C, F] mean square of what offset, gain and shift leave, grey levels²
    change: np.ndarray  # [C, F] the same of offset and gain alone


class Turn(NamedTuple):
    """The turn that is an unknown beside the shift: by one pixel at a distance of `radius` from the centre."""

    centre: tuple[float, float]  # pixels right and down
    radius: float  # pixels


class Template:
    """A mean picture cut into parts: pictures to inner products, and these to offsets, gains and shifts."""

    def __init__(self, mean: np.ndarray, parts: Parts, turn: Turn | None = None) -> None:
        """mean: [H, W] float32."""
        self.mean, self.parts = mean, parts
        dx, dy = slope(mean, 1), slope(mean, 0)
        dxx, dxy, dyy = slope(dx, 1), slope(dx, 0), slope(dy, 0)
        higher = (dxx, dxy, dyy, slope(dxx, 1), slope(dxx, 0), slope(dyy, 1), slope(dyy, 0))
        self._rest, ones = self._cut(mean), self._cut(np.ones_like(mean))
        self._pixels = (ones**2).sum(1)
        level = (self._rest * ones).sum(1) / self._pixels
        contrast = self._rest - level[:, None] * ones
        model = np.stack([ones, contrast, *(self._cut(g) for g in _changes(dx, dy, turn))], 2)
        right, down = (ndimage.gaussian_filter(g, _SMOOTH_PX, mode="nearest") for g in (dx, dy))
        instruments = np.stack([ones, contrast, *(self._cut(g) for g in _changes(right, down, turn))], 2)
        self._columns = np.concatenate([model, instruments[..., 2:]], 2)  # [C, P, 6 or 8]
        self._model_products = _products(model, model)
        light = self._model_products[:, :2, :2]
        self._inverse_light = np.linalg.inv(light + 1e-6 * light[:, :1, :1] * np.eye(2))
        # [C, 4, 4] or [C, 5, 5]: instruments by the model, and by themselves
        self.by_model, self.of_instruments = (
            _products(instruments, model),
            _products(instruments, instruments),
        )
        ridge = 1e-6 * np.einsum("cii->ci", self.by_model).clip(1e-3)[:, :, None] * np.eye(model.shape[2])
        self._inverse = np.linalg.inv(self.by_model + ridge)
        self._higher = _products(instruments, np.stack([self._cut(h) for h in higher], 2))
        of_noise = (self._inverse @ self.of_instruments @ self._inverse.transpose(0, 2, 1))[:, 2:4, 2:4]
        is_plain = np.einsum("cii->c", self.of_instruments[:, 2:4, 2:4]) < _PLAIN
        # [C, 2, 2] of a shift, px², for noise of variance 1
        self.covariance = np.where(is_plain[:, None, None], _UNKNOWN * np.eye(2), of_noise)

    def products(self, pictures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inner products [C, F, 6 or 8] and energies [C, F] of the differences of pictures [F, H, W] from the mean."""
        difference = self.difference(pictures)
        return difference @ self._columns, np.einsum("cfp,cfp->cf", difference, difference)

    def difference(self, pictures: np.ndarray) -> np.ndarray:
        """Return [C, F, P] of pictures [F, H, W] from the mean."""
        difference = self.parts.cut(pictures)
        difference -= self._rest[:, None]
        return difference

    def banded_products(self, difference: np.ndarray, part: int, bands: Sequence[slice]) -> np.ndarray:
        """Return [B, F, 6 or 8]: the inner products of one part's differences [F, P], for bands of its pixels apart."""
        return np.stack([difference[:, band] @ self._columns[part, band] for band in bands])

    def motion_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the normal matrices [C, K, K] of each part's K motions, with offset and gain eliminated.

        Beside them the covariances [C, K, K] of their right-hand sides for noise of variance 1.
        """
        a, light, motion = self.by_model, slice(0, 2), slice(2, None)
        ridge = 1e-6 * np.einsum("cii->c", a[:, light, light])[:, None, None] * np.eye(2)
        back = -a[:, motion, light] @ np.linalg.inv(a[:, light, light] + ridge)
        normals = a[:, motion, motion] + back @ a[:, light, motion]
        left = np.concatenate(
            [back, np.broadcast_to(np.eye(back.shape[1]), (len(a), *back.shape[1:2] * 2))], 2
        )
        return normals, left @ self.of_instruments @ left.transpose(0, 2, 1)

    def together(self, shift: np.ndarray) -> np.ndarray:
        """Return [F, 2] of shifts [C, F, 2 or 3]: their mean, weighted by each part's information."""
        if len(shift) == 1:
            return np.asarray(shift[0, :, :2])
        normals = self.motion_equations()[0]
        total, weighted = normals.sum(0), np.einsum("cij,cfj->fi", normals, np.nan_to_num(shift))
        ridge = (1e-9 * np.trace(total) + 1e-12) * np.eye(len(total))
        return np.asarray(np.linalg.solve(total + ridge, weighted.T).T[:, :2])

    def solved(self, products: np.ndarray, energy: np.ndarray) -> Solved:
        """Shifts, gains and mean squares from inner products [C, F, 6 or 8] and energies [C, F]."""
        unknowns = self.by_model.shape[1]
        by_model, of_motion = products[..., :unknowns], products[..., unknowns:]
        by_instrument = np.concatenate([by_model[..., :2], of_motion], -1)
        light = by_model[..., :2] @ self._inverse_light
        change = energy - (light * by_model[..., :2]).sum(-1)
        p = np.einsum("cij,cfj->cfi", self._inverse, by_instrument)
        first, linear = p.copy(), self._left(p, by_model, energy)
        large = np.flatnonzero(np.percentile(np.abs(p[..., 2:4]), 95, axis=(1, 2)) > _LINEAR_PX)
        for _ in range(_STEPS if len(large) else 0):
            curved = np.einsum("cij,cfj->cfi", self._higher[large], _higher_terms(p[large]))
            p[large] = np.einsum("cij,cfj->cfi", self._inverse[large], by_instrument[large] - curved)
        left = self._left(p, by_model, energy)
        diverged = left > _DIVERGED * np.maximum(linear, 1.0)
        p, left = np.where(diverged[..., None], first, p), np.where(diverged, linear, left)
        unlike = left > _DIVERGED * np.maximum(
            change, 1.0
        )  # where hardly any texture is, instruments mislead
        p[unlike] = np.concatenate([light, np.zeros((*light.shape[:2], unknowns - 2))], -1)[unlike]
        left = np.where(unlike, change, left)
        gain = 1 + p[..., 1]
        shift = p[..., 2:] / np.where(np.abs(gain) > _LEAST_GAIN, gain, np.nan)[..., None]
        pixels = self._pixels[:, None]
        return Solved(
            shift,
            gain,
            np.maximum(left, 0) / np.maximum(pixels - unknowns, 1),
            np.maximum(change, 0) / np.maximum(pixels - 2, 1),
        )

    def _left(self, p: np.ndarray, by_model: np.ndarray, energy: np.ndarray) -> np.ndarray:
        """Return [C, F]: the energy that offset, gain and shift leave."""
        left = energy - 2 * (p * by_model).sum(-1)
        return np.asarray(left + np.einsum("cfi,cij,cfj->cf", p, self._model_products, p, optimize=True))

    def _cut(self, picture: np.ndarray) -> np.ndarray:
        return self.parts.cut(picture[None])[:, 0]


def _changes(dx: np.ndarray, dy: np.ndarray, turn: Turn | None) -> list[np.ndarray]:
    """Return a picture's changes for a shift by a pixel right, down, and a counter-clockwise turn; slopes [H, W]."""
    if turn is None:
        return [-dx, -dy]
    down, right = np.mgrid[: dx.shape[0], : dx.shape[1]].astype(np.float32) + 0.5
    (x, y), radius = turn
    return [-dx, -dy, ((right - x) * dy - (down - y) * dx) / radius]


@lru_cache
def false_information(size: int) -> float:
    """Return the apparent information, px⁻², of a cell of noise, times the number of pictures in its mean.

    Noise of the mean picture is no texture: it does not appear in other pictures. Estimated on white noise of any
    strength.
    """
    noise = np.random.default_rng(0).normal(size=(8 * size, 8 * size)).astype(np.float32)
    covariance = Template(noise, Grid(8, 8, size)).covariance
    return float(np.linalg.inv(covariance)[:, [0, 1], [0, 1]].mean())


def slope(picture: np.ndarray, axis: int) -> np.ndarray:
    """Return the derivative of a picture along an axis, grey levels a pixel."""
    return np.asarray(ndimage.correlate1d(picture, _DERIVATIVE, axis, mode="nearest"))


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a.transpose(0, 2, 1) @ b)


def _higher_terms(p: np.ndarray) -> np.ndarray:
    """Return [C, F, 7]: factors of M's second and third derivatives (xx, xy, yy, xxx, xxy, xyy, yyy) in d."""
    gain = 1 + p[..., 1]
    x, y = (np.clip(p[..., k] / gain, -_FURTHEST_PX, _FURTHEST_PX) for k in (2, 3))
    xx, xy, yy = (q.mean(1, keepdims=True) for q in (x * x, x * y, y * y))
    terms = (
        *((x * x - xx) / 2, x * y - xy, (y * y - yy) / 2, -(x**3 - 3 * xx * x) / 6),
        *(-(x * x * y - xx * y - 2 * xy * x) / 2, -(x * y * y - yy * x - 2 * xy * y) / 2),
        -(y**3 - 3 * yy * y) / 6,
    )
    return np.stack(terms, -1) * gain[..., None]
