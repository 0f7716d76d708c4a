"""Where fixed points touch three feature planes: bilinear weights, and the few cells that have any.

[TG4MM] Eq. (4). The points that a triplane is sampled at never move, so sampling is one constant sparse matrix, and
only cells that touch a point ever get a gradient. Adam leaves a parameter whose gradient is always zero where it is; so
training the touched ("active") cells alone is training the dense planes, at a hundredth of the cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PLANES = ((0, 1), (0, 2), (1, 2))  # xy, xz, yz: the coordinates along columns and rows
_OUTER = (0.5, 99.5)  # percentiles of the points that the box spans; points beyond lie on its border


@dataclass(frozen=True, eq=False)
class Cells:
    """A cells of three R×R planes, touched by N points; all indices are into the A compact cells.

    A point's value on plane k is Σ_j weight[k, n, j] · values[index[k, n, j]].
    """

    resolution: int  # R
    dense: np.ndarray  # [A] int64, k · R² + row · R + column, ascending
    index: np.ndarray  # [3, N, 4] int32
    weight: np.ndarray  # [3, N, 4] float32, each four sum to 1
    first: np.ndarray  # [A + 1] int32: entries first[a] … first[a + 1] − 1 of the next three belong to cell a
    point: np.ndarray  # [12 N] int32
    plane: np.ndarray  # [12 N] int8
    share: np.ndarray  # [12 N] float32, the weights again

    def __len__(self) -> int:
        return len(self.dense)

    def of_plane(self, k: int) -> slice:
        """The compact cells of plane k."""
        size = self.resolution**2
        return slice(*(int(np.searchsorted(self.dense, size * i)) for i in (k, k + 1)))


def scene_box(points: np.ndarray) -> np.ndarray:
    """[2, 3] low and high corner of the points [N, 3], but for the outermost half percent on each side."""
    low, high = np.percentile(points, _OUTER, axis=0)
    return np.stack([low, np.maximum(high, low + 1e-6)])


def cells_of(points: np.ndarray, box: np.ndarray, resolution: int) -> Cells:
    """The cells that points [N, 3] touch; `box` [2, 3] is normalised to 0..1, cell centres on its border included.

    As `grid_sample` with `align_corners=True, padding_mode="border"` on planes whose rows are the second coordinate.
    """
    unit = np.clip((points.astype(np.float64) - box[0]) / (box[1] - box[0]), 0, 1)
    position = unit * (resolution - 1)
    corner = np.minimum(position.astype(np.int64), resolution - 2)
    fraction = position - corner
    index = np.empty((3, len(points), 4), np.int64)
    weight = np.empty((3, len(points), 4), np.float32)
    for k, (u, v) in enumerate(PLANES):
        for j, (du, dv) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
            index[k, :, j] = (k * resolution + corner[:, v] + dv) * resolution + corner[:, u] + du
            wu = fraction[:, u] if du else 1 - fraction[:, u]
            weight[k, :, j] = wu * (fraction[:, v] if dv else 1 - fraction[:, v])
    dense, compact = np.unique(index.ravel(), return_inverse=True)
    order = np.argsort(compact, kind="stable")
    n = len(points)
    return Cells(
        resolution=resolution,
        dense=dense,
        index=compact.reshape(index.shape).astype(np.int32),
        weight=weight,
        first=np.concatenate([[0], np.cumsum(np.bincount(compact, minlength=len(dense)))]).astype(np.int32),
        point=((order // 4) % n).astype(np.int32),
        plane=(order // (4 * n)).astype(np.int8),
        share=weight.ravel()[order],
    )
