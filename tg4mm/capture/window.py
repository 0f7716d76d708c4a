"""A window on pictures: a part of them, in which squares of pixels are averaged to one."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Window:
    """Rows and columns of a picture, whole numbers of squares of `factor` pixels."""

    top: int
    left: int
    rows: int  # of the window's own pixels
    columns: int
    factor: int

    @staticmethod
    def on(
        height: int, width: int, factor: int = 1, wanted: np.ndarray | None = None, margin: int = 0
    ) -> "Window":
        """About the pixels `wanted` [H, W] bool, and `margin` pixels around them, or the whole picture.

        What makes no whole square is cut off.
        """
        rows, columns = slice(0, height), slice(0, width)
        if wanted is not None:
            rows, columns = (_reach(wanted.any(axis), margin) for axis in (1, 0))
        n_rows, n_columns = (max((s.stop - s.start) // factor, 1) for s in (rows, columns))
        return Window(rows.start, columns.start, n_rows, n_columns, factor)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in its own pixels."""
        return self.rows, self.columns

    def K(self, K: np.ndarray) -> np.ndarray:
        """[..., 3, 3]: intrinsics in its own pixels."""
        out = K.copy()
        out[..., :2, 2] -= np.array([self.left, self.top], K.dtype)
        out[..., :2, :] /= self.factor
        return out

    def part(self, image: np.ndarray) -> np.ndarray:
        """[rows · factor, columns · factor, …] of an image [H, W, …], as it is."""
        height, width = self.rows * self.factor, self.columns * self.factor
        return image[self.top : self.top + height, self.left : self.left + width]

    def all_of(self, mask: np.ndarray) -> np.ndarray:
        """[rows, columns] bool: where every pixel of a square is in the mask [H, W]."""
        return self._squares(self.part(mask)).all((1, 3))

    def any_of(self, mask: np.ndarray) -> np.ndarray:
        """[rows, columns] bool: where a pixel of a square is in the mask [H, W]."""
        return self._squares(self.part(mask)).any((1, 3))

    def averaged(self, image: np.ndarray) -> np.ndarray:
        """[rows, columns, 4] of a stored RGBA image [H, W, 4]; of squares of several pixels uint16, 65535 is 1.

        Colours count by their alpha, as straight alpha has it.
        """
        part = self.part(image)
        if self.factor == 1:
            return part
        scale = 257 if image.dtype == np.uint8 else 1
        alpha = part[..., 3]
        if alpha.min() == np.iinfo(image.dtype).max:
            total = self._sum(part)
            return ((total * scale + self.factor**2 // 2) // self.factor**2).astype(np.uint16)
        coverage = self._sum(alpha[..., None]).astype(np.float64)
        colour = self._sum(part[..., :3].astype(np.uint64) * alpha[..., None])
        out = np.concatenate([colour / np.maximum(coverage, 1), coverage / self.factor**2], axis=-1)
        return np.rint(out * scale).astype(np.uint16)

    def _sum(self, part: np.ndarray) -> np.ndarray:
        """[rows, columns, C] uint32 or uint64: sums over squares, first of rows, whose pixels lie together."""
        kind, k = (np.uint64 if part.dtype == np.uint64 else np.uint32), self.factor
        down: np.ndarray = part[::k].astype(kind)
        for i in range(1, k):
            down += part[i::k]
        out = down[:, ::k].copy()
        for j in range(1, k):
            out += down[:, j::k]
        return out

    def _squares(self, part: np.ndarray) -> np.ndarray:
        return part.reshape(self.rows, self.factor, self.columns, self.factor)


def _reach(some: np.ndarray, margin: int) -> slice:
    where = np.flatnonzero(some)
    if not len(where):
        return slice(0, len(some))
    return slice(max(int(where[0]) - margin, 0), min(int(where[-1]) + 1 + margin, len(some)))
