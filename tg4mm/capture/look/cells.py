"""Shifts of a picture's cells against the mean picture, from six inner products a cell and picture.

A cell of S × S pixels differs from the mean picture M by d = o + (g − 1) (M − mean M) − g u · ∇M + …: offset o, gain g
and shift u are least squares with instruments, [1, M, ∇ of a smoothed M], which are correlated with the noise of d
less than ∇M itself (Bowden & Turkington 1984). Terms up to third order in u follow by Gauss-Newton steps on the same
products; what the motion itself took from the mean picture (its second and third moments) is taken off them.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

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
_DIVERGED = 2.0  # times what a simpler answer leaves
_LEAST_GAIN = 0.2  # a darker cell shows something else


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
        """[C, F, S²] float32 of pictures [F, H, W]."""
        n, size = len(pictures), self.size
        rows, columns = (slice(self.edge, self.edge + n * size) for n in (self.rows, self.columns))
        inside = pictures[:, rows, columns]
        tiles = inside.reshape(n, self.rows, size, self.columns, size).transpose(1, 3, 0, 2, 4)
        return np.ascontiguousarray(tiles, np.float32).reshape(len(self), n, size * size)

    def picture(self, values: np.ndarray) -> np.ndarray:
        """[..., rows, columns] of values [..., C]."""
        return values.reshape(*values.shape[:-1], self.rows, self.columns)

    def centres(self) -> np.ndarray:
        """[C, 2] pixels right and down."""
        row, column = np.divmod(np.arange(len(self)), self.columns)
        return (np.stack([column, row], 1) + 0.5) * self.size + self.edge

    def box(self, cells: np.ndarray) -> tuple[int, int, int, int]:
        """Left, upper, right and lower edge, pixels, of cells [C] bool or their indices."""
        row, column = np.divmod(np.flatnonzero(cells) if cells.dtype == bool else cells, self.columns)
        edges = (column.min(), row.min(), column.max() + 1, row.max() + 1)
        left, upper, right, lower = (int(edge) * self.size + self.edge for edge in edges)
        return left, upper, right, lower


class Solved(NamedTuple):
    """What C cells show in F pictures."""

    shift: np.ndarray  # [C, F, 2] pixels right and down; NaN where a cell is dark
    gain: np.ndarray  # [C, F]
    misfit: np.ndarray  # [C, F] mean square of what offset, gain and shift leave, grey levels²
    change: np.ndarray  # [C, F] the same of offset and gain alone


class Template:
    """A mean picture cut into cells: pictures to inner products, and these to offsets, gains and shifts."""

    def __init__(self, mean: np.ndarray, grid: Grid) -> None:
        """mean: [H, W] float32."""
        self.mean, self.grid = mean, grid
        dx, dy = slope(mean, 1), slope(mean, 0)
        dxx, dxy, dyy = slope(dx, 1), slope(dx, 0), slope(dy, 0)
        higher = (dxx, dxy, dyy, slope(dxx, 1), slope(dxx, 0), slope(dyy, 1), slope(dyy, 0))
        self._rest = self._cells(mean)
        contrast = self._rest - self._rest.mean(1, keepdims=True)
        model = np.stack([np.ones_like(contrast), contrast, -self._cells(dx), -self._cells(dy)], 2)
        smoothed = [-self._cells(ndimage.gaussian_filter(g, _SMOOTH_PX, mode="nearest")) for g in (dx, dy)]
        instruments = np.stack([model[..., 0], contrast, *smoothed], 2)
        self._columns = np.concatenate([model, instruments[..., 2:]], 2)  # [C, S², 6]
        self._model_products = _products(model, model)
        light = self._model_products[:, :2, :2]
        self._inverse_light = np.linalg.inv(light + 1e-6 * light[:, :1, :1] * np.eye(2))
        by_model = _products(instruments, model)
        ridge = 1e-6 * np.einsum("cii->ci", by_model).clip(1e-3)[:, :, None] * np.eye(4)
        self._inverse = np.linalg.inv(by_model + ridge)
        self._higher = _products(instruments, np.stack([self._cells(h) for h in higher], 2))
        of_instruments = _products(instruments, instruments)
        of_noise = (self._inverse @ of_instruments @ self._inverse.transpose(0, 2, 1))[:, 2:, 2:]
        is_plain = np.einsum("cii->c", of_instruments[:, 2:, 2:]) < _PLAIN
        # [C, 2, 2] of a shift, px², for noise of variance 1
        self.covariance = np.where(is_plain[:, None, None], _UNKNOWN * np.eye(2), of_noise)

    def products(self, pictures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inner products [C, F, 6] and energies [C, F] of the differences of pictures [F, H, W] from the mean."""
        difference = self.grid.cut(pictures)
        difference -= self._rest[:, None]
        return difference @ self._columns, np.einsum("cfp,cfp->cf", difference, difference)

    def solved(self, products: np.ndarray, energy: np.ndarray) -> Solved:
        """Shifts, gains and mean squares from inner products [C, F, 6] and energies [C, F]."""
        by_model, by_instrument = products[..., :4], products[..., [0, 1, 4, 5]]
        light = by_model[..., :2] @ self._inverse_light
        change = energy - (light * by_model[..., :2]).sum(-1)
        p = np.einsum("cij,cfj->cfi", self._inverse, by_instrument)
        first, linear = p.copy(), self._left(p, by_model, energy)
        large = np.flatnonzero(np.percentile(np.abs(p[..., 2:]), 95, axis=(1, 2)) > _LINEAR_PX)
        for _ in range(_STEPS if len(large) else 0):
            curved = np.einsum("cij,cfj->cfi", self._higher[large], _higher_terms(p[large]))
            p[large] = np.einsum("cij,cfj->cfi", self._inverse[large], by_instrument[large] - curved)
        left = self._left(p, by_model, energy)
        diverged = left > _DIVERGED * np.maximum(linear, 1.0)
        p, left = np.where(diverged[..., None], first, p), np.where(diverged, linear, left)
        unlike = left > _DIVERGED * np.maximum(
            change, 1.0
        )  # where hardly any texture is, instruments mislead
        p[unlike] = np.concatenate([light, np.zeros_like(light)], -1)[unlike]
        left = np.where(unlike, change, left)
        gain = 1 + p[..., 1]
        shift = p[..., 2:] / np.where(np.abs(gain) > _LEAST_GAIN, gain, np.nan)[..., None]
        pixels = self.grid.size**2
        return Solved(shift, gain, np.maximum(left, 0) / (pixels - 4), np.maximum(change, 0) / (pixels - 2))

    def _left(self, p: np.ndarray, by_model: np.ndarray, energy: np.ndarray) -> np.ndarray:
        """[C, F]: the energy that offset, gain and shift leave."""
        left = energy - 2 * (p * by_model).sum(-1)
        return np.asarray(left + np.einsum("cfi,cij,cfj->cf", p, self._model_products, p, optimize=True))

    def _cells(self, picture: np.ndarray) -> np.ndarray:
        return self.grid.cut(picture[None])[:, 0]


@lru_cache
def false_information(size: int) -> float:
    """px⁻² that a cell of noise alone seems to have, times the pictures that its mean is of.

    The mean picture's own noise is no texture: others do not show it again. Found on white noise, of whatever strength.
    """
    noise = np.random.default_rng(0).normal(size=(8 * size, 8 * size)).astype(np.float32)
    covariance = Template(noise, Grid(8, 8, size)).covariance
    return float(np.linalg.inv(covariance)[:, [0, 1], [0, 1]].mean())


def slope(picture: np.ndarray, axis: int) -> np.ndarray:
    """Of a picture along an axis, grey levels a pixel."""
    return np.asarray(ndimage.correlate1d(picture, _DERIVATIVE, axis, mode="nearest"))


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a.transpose(0, 2, 1) @ b)


def _higher_terms(p: np.ndarray) -> np.ndarray:
    """[C, F, 7]: factors of M's second and third derivatives (xx, xy, yy, xxx, xxy, xyy, yyy) in d."""
    gain = 1 + p[..., 1]
    x, y = (np.clip(p[..., k] / gain, -_FURTHEST_PX, _FURTHEST_PX) for k in (2, 3))
    xx, xy, yy = (q.mean(1, keepdims=True) for q in (x * x, x * y, y * y))
    terms = (
        *((x * x - xx) / 2, x * y - xy, (y * y - yy) / 2, -(x**3 - 3 * xx * x) / 6),
        *(-(x * x * y - xx * y - 2 * xy * x) / 2, -(x * y * y - yy * x - 2 * xy * y) / 2),
        -(y**3 - 3 * yy * y) / 6,
    )
    return np.stack(terms, -1) * gain[..., None]
