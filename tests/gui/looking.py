"""What a test says of a screenshot: is anything on it, did it change."""

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
