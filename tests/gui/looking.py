"""What a test says of a screenshot: is anything on it, did it change, has it colours."""

from dataclasses import dataclass

import numpy as np


def cut(picture, box):
    """The part of a picture [H, W, 3] inside a box."""
    return picture[box.top : box.top + box.height, box.left : box.left + box.width]


def is_blank(picture):
    """True where nearly all pixels are alike, black or otherwise: software OpenGL that failed, a dead screen."""
    if picture.size == 0:
        return True
    _, counts = np.unique(picture.reshape(-1, 3) // 8, axis=0, return_counts=True)
    return bool(counts.max() > 0.97 * counts.sum())


def changed(a, b, by=12):
    """Share of the pixels of which some channel differs by more than `by` of 255."""
    return float((np.abs(a.astype(int) - b.astype(int)).max(axis=2) > by).mean())


def coloured(picture, by=40):
    """Share of the pixels that are not grey: largest less smallest channel above `by` of 255."""
    return float((picture.max(axis=2).astype(int) - picture.min(axis=2) > by).mean())


# The marks before the titles of folded and open panels, as Blender 5.2 draws them at scale 1: brightness over
# the background.
_FOLDED = np.array(
    [
        [79, 46, 1, 0, 0, 0, 0],
        [44, 133, 46, 1, 0, 0, 0],
        [0, 44, 133, 46, 1, 0, 0],
        [0, 0, 44, 133, 46, 1, 0],
        [0, 0, 0, 45, 134, 45, 1],
        [0, 0, 0, 4, 109, 89, 1],
        [0, 0, 4, 97, 112, 11, 0],
        [0, 4, 96, 113, 11, 0, 0],
        [4, 96, 113, 11, 0, 0, 0],
        [85, 113, 11, 0, 0, 0, 0],
        [35, 8, 0, 0, 0, 0, 0],
    ]
)
_OPEN = np.array(
    [
        [83, 40, 1, 0, 0, 0, 0, 1, 38, 84],
        [40, 126, 40, 1, 0, 0, 1, 38, 126, 40],
        [0, 40, 126, 39, 1, 1, 38, 125, 40, 1],
        [0, 0, 40, 126, 39, 38, 126, 41, 1, 0],
        [0, 0, 0, 40, 126, 126, 41, 1, 0, 0],
        [0, 0, 0, 0, 31, 32, 0, 0, 0, 0],
    ]
)
_ALIKE = 0.96  # correlation; the letters of a panel stay below 0.9


@dataclass(frozen=True)
class Header:
    """The mark of a panel's header: its middle, and whether the panel is open."""

    x: int
    y: int
    open: bool


def headers(picture, strip):
    """The headers of panels in a strip of a screenshot [H, W, 3], from the top."""
    grey = cut(picture, strip).astype(float).mean(axis=2)
    found: list[Header] = []
    for mark, is_open in ((_FOLDED, False), (_OPEN, True)):
        for y, x in zip(*np.nonzero(_correlation(grey, mark) > _ALIKE), strict=True):
            middle = strip.left + x + mark.shape[1] // 2, strip.top + y + mark.shape[0] // 2
            if not any(abs(h.x - middle[0]) + abs(h.y - middle[1]) < 6 for h in found):
                found.append(Header(int(middle[0]), int(middle[1]), is_open))
    return sorted(found, key=lambda header: header.y)


def _correlation(grey, mark):
    """[H', W'] −1..1: how alike the mark and the patch with this upper left corner are."""
    patches = np.lib.stride_tricks.sliding_window_view(grey, mark.shape)
    patches = patches - patches.mean(axis=(2, 3), keepdims=True)
    centred = mark - mark.mean()
    size = np.sqrt((patches**2).sum(axis=(2, 3))) * np.sqrt((centred**2).sum())
    dots = np.einsum("yxij,ij->yx", patches, centred)
    return np.where(size > 200.0 * centred.std(), dots / np.maximum(size, 1e-9), 0.0)
