"""Whether a fixed camera shakes: does what moves least in its pictures move as one?

The picture is looked at in 8 × 8 blocks. Each block's shift in every frame is the least-squares answer of its pixels by
the picture's slopes (Lucas & Kanade 1981). A camera that shakes moves every block, by a shift, a roll and a zoom of the
whole picture; a scene that moves before a camera that does not leaves some blocks where they are. So the blocks that
move least decide: they must move by more than noise, and by what one shift, roll and zoom makes of all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

BLOCKS = 8  # along each side
_TEXTURE = 0.05  # of the mean block's: less tells no shift
_STILLEST = 0.25  # of the blocks with texture
_LEAST_PX = 0.01  # rms; less is none
_EXPLAINED = 0.7  # of the stillest blocks' power must be that of one pose
_ROUNDS = 5  # of reweighting


@dataclass
class BlockShifts:
    """Sums over one view's frames: products of slopes with changes."""

    slopes: np.ndarray  # [2, H, W, 3] float32: what a shift right, down by a pixel changes
    gram: np.ndarray  # [B, B, 2, 2]
    products: np.ndarray  # [B, B, 2, F]
    energy: np.ndarray  # [B, B] of the changes

    @staticmethod
    def of(picture: np.ndarray, n_frames: int) -> BlockShifts:
        """picture [H, W, 3]: at rest."""
        down, right = np.gradient(picture, axis=(0, 1))
        slopes = -np.stack([right, down]).astype(np.float32)
        gram = np.zeros((BLOCKS, BLOCKS, 2, 2))
        for i, j, (tall, wide) in _parts(picture.shape[:2]):
            flat = slopes[:, tall, wide].reshape(2, -1)
            gram[i, j] = flat @ flat.T
        return BlockShifts(slopes, gram, np.zeros((BLOCKS, BLOCKS, 2, n_frames)), np.zeros((BLOCKS, BLOCKS)))

    def add(self, rows: slice, changes: np.ndarray) -> None:
        """A strip of changes [F, rows, W, 3]."""
        for i, j, (tall, wide) in _parts(self.slopes.shape[1:3]):
            top, bottom = max(tall.start, rows.start), min(tall.stop, rows.stop)
            if top >= bottom:
                continue
            own = changes[:, top - rows.start : bottom - rows.start, wide].reshape(len(changes), -1)
            self.products[i, j] += self.slopes[:, top:bottom, wide].reshape(2, -1) @ own.T
            self.energy[i, j] += float((own**2).sum())

    def shake(self) -> tuple[float, bool]:
        """Shift of the blocks that move least (pixels, rms over frames), and whether one pose explains it."""
        texture = np.linalg.eigvalsh(self.gram)[..., 0]
        has_texture = texture > _TEXTURE * max(float(texture.mean()), 1e-30)
        if has_texture.sum() < 8:
            return 0.0, False
        gram, products = self.gram[has_texture], self.products[has_texture]
        shifts = np.linalg.solve(gram, products)  # [b, 2, F]
        n = self.slopes[0].size / BLOCKS**2
        left = self.energy[has_texture] - np.einsum("bcf,bcf->b", shifts, products)
        noise = np.maximum(left, 0) / n * np.trace(np.linalg.inv(gram), axis1=1, axis2=2)  # sum over frames
        power = np.maximum((shifts**2).sum((1, 2)) - noise, 0)
        places = np.argwhere(has_texture) / (BLOCKS - 1) - 0.5
        residual = shifts - _one_pose(places, shifts, texture[has_texture])
        unexplained = np.maximum((residual**2).sum((1, 2)) - noise, 0)
        stillest = np.argsort(power)[: max(int(_STILLEST * len(power)), 2)]
        moved = float(np.sqrt(power[stillest].mean() / shifts.shape[2]))
        share = 1 - unexplained[stillest].sum() / max(power[stillest].sum(), 1e-30)
        return moved, bool(moved > _LEAST_PX and share > _EXPLAINED)


def _parts(size: tuple[int, ...]) -> Iterator[tuple[int, int, tuple[slice, slice]]]:
    rows, columns = (np.linspace(0, n, BLOCKS + 1).round().astype(int) for n in size)
    for i in range(BLOCKS):
        for j in range(BLOCKS):
            yield i, j, (slice(rows[i], rows[i + 1]), slice(columns[j], columns[j + 1]))


def _one_pose(places: np.ndarray, shifts: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """[b, 2, F]: the shift, roll and zoom that most blocks follow, at blocks `places` [b, 2] (down, right).

    Iteratively reweighted least squares, so that blocks which move by themselves count little.
    """
    y, x = places.T
    one, zero = np.ones_like(x), np.zeros_like(x)
    design = np.stack([np.stack([one, zero, -y, x], 1), np.stack([zero, one, x, y], 1)], 1)  # [b, 2, 4]
    trust = weights / weights.max()
    fitted = shifts
    for _ in range(_ROUNDS):
        root = np.sqrt(trust)[:, None, None]
        flat = (root * design).reshape(-1, 4)
        answer = np.linalg.lstsq(flat, (root * shifts).reshape(len(flat), -1), rcond=None)[0]
        fitted = design @ answer
        error = np.sqrt(((shifts - fitted) ** 2).mean((1, 2)))
        trust = weights / weights.max() / (1 + (error / max(float(np.median(error)), 1e-12)) ** 2)
    return fitted
