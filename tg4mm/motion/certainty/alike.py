"""What all cameras get wrong alike, and no two halves of them show: errors of the model and of the prior.

Two things tell of it, both read off the result. What motion leaves of the pictures: noise hardly adds up over a block
of pixels, errors of the model do, and that block's mean over the slope of the picture is the displacement that it could
be; a small part of it is. And what the motion varies by from one Gaussian to those around it: the prior has them move
alike, so that at a joint, an edge or a contact what is one side's and what the other's is mostly its guess. How much
either counts was found on generated scenes, whose motion is known: docs/decisions.md, "what all cameras get wrong".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from tg4mm.motion.certainty.halves import mean_around
from tg4mm.motion.jacobian.colour import blend_sum
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.pictures.video import FixedCamera

BLOCK = 4  # pixels: side of what an error of the model reaches over
_OF_LEFT = 0.04  # of the square of the displacement that the remainder could be
_OF_VARIATION = 2.5  # of the variance over 32 Gaussians
_FLAT = 0.01  # of the scene's mean squared slope: as flat as anything counts
_TINY = float(np.finfo(np.float32).tiny)


def alike(left: np.ndarray, varying: np.ndarray) -> np.ndarray:
    """Variance of the displacement [N], of the squares [N] that `displacement_left` and `variation` give."""
    return _OF_LEFT * left + _OF_VARIATION * varying


def variation(shapes: np.ndarray, around: np.ndarray) -> np.ndarray:
    """[N] float64, scene units squared: variance of R fields [R, N, 3] over the Gaussians `around` each [N, count].

    Sums over fields and over x, y, z.
    """
    out = np.zeros(shapes.shape[1])
    for shape in shapes.astype(np.float64):
        squares = np.einsum("nc,nc->n", shape, shape)
        out += mean_around(squares, around) - (mean_around(shape, around) ** 2).sum(1)
    return np.maximum(out, 0)


def displacement_left(
    left: Iterable[np.ndarray],
    views: Sequence[ViewJacobian],
    cameras: Sequence[FixedCamera],
    means: np.ndarray,
    around: np.ndarray,
) -> np.ndarray:
    """[N] float64, scene units squared: the displacement that could be what is left of component images.

    left: of every view [R, H, W, 3]; means [N, 3], the Gaussians' places. Means of the squares over pixels by the
    blending weights of the Gaussians `around` each [N, count]; over the whole scene where no camera sees any of these.
    A surface counts as no flatter than a hundredth of the scene's mean squared slope.
    """
    seen = np.zeros((len(means), 3))  # of what is left, of what a unit of displacement changes, of pixels
    for pictures, view, camera in zip(left, views, cameras, strict=True):
        slopes = _slopes(view)
        told = blend_sum(view, np.stack([_of_blocks(pictures), slopes, np.ones_like(slopes)], -1))
        depth = means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        per_unit = np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / np.where(told[:, 2] > 0, depth, 1)  # pixels
        told[:, 1:] *= per_unit[:, None] ** 2
        seen += told
    around_each, everywhere = mean_around(seen, around), seen.sum(0)
    flat = _FLAT * around_each[:, 2] * everywhere[1] / max(everywhere[2], _TINY)
    found = around_each[:, 0] / np.maximum(np.maximum(around_each[:, 1], flat), _TINY)
    return np.where(around_each[:, 2] > 0, found, everywhere[0] / max(everywhere[1], _TINY))


def _of_blocks(pictures: np.ndarray) -> np.ndarray:
    """[H, W]: squares of the means over blocks of pictures [R, H, W, 3]; sums over pictures and channels."""
    height, width = pictures.shape[1:3]
    rows, columns = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    means = np.add.reduceat(np.add.reduceat(pictures, rows, axis=1), columns, axis=2)
    tall, wide = np.diff(rows, append=height), np.diff(columns, append=width)
    means /= np.outer(tall, wide).astype(np.float32)[..., None]
    squares = np.einsum("rhwc,rhwc->hw", means, means)
    return np.asarray(squares.repeat(tall, 0).repeat(wide, 1))


def _slopes(view: ViewJacobian) -> np.ndarray:
    """[H, W]: the squared gradient of the picture at rest over white, per pixel; sums over channels."""
    picture = view.image[..., :3] + view.transmittance[..., None]
    down, right = np.gradient(picture, axis=(0, 1))
    return np.asarray((down**2 + right**2).sum(-1))
