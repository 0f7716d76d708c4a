"""Sensors' equations straight from the pictures, for a capture of which one call measures a few of them.

A sensor needs of a frame E·Jᵀ W (1 − Q Qᵀ W) d_f alone: products of the frame's change d_f with the pictures of its K
motions, J E, weighted, and with the nuisance columns Q. That is a hundredth of the work of pulling d_f back to all
Gaussians (`residuals.py`), with the same result; other sensors read the pictures again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.capture.pictures import over_white
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import Observations
from tg4mm.show.measure.residuals import AT_ONCE, MeasuredView
from tg4mm.show.measure.sides import HALVES

Box = tuple[slice, slice]


@dataclass(frozen=True)
class Products:
    """What of a frame's change one body needs in one half of one view's data."""

    box: Box  # of the picture, outside which its motions change nothing
    rows: np.ndarray  # [K, h · w · 3] float32, W J E
    shares: np.ndarray | None  # [K, k] its products with the nuisance basis


def boxed(changes: np.ndarray) -> Box:
    """Where pictures [K, H, W, 3] are not 0."""
    some = changes.any((0, 3))
    found = []
    for axis in (1, 0):
        i = np.flatnonzero(some.any(axis))
        found.append(slice(int(i[0]), int(i[-1]) + 1) if len(i) else slice(0, 0))
    return found[0], found[1]


def products_of(changes: np.ndarray, weights: np.ndarray, basis: np.ndarray | None) -> Products:
    """Of J E [K, H, W, 3] with weights [H, W] and the basis Q [k, H, W, 3]."""
    box = boxed(changes)
    rows = changes[:, box[0], box[1]] * weights[box][..., None]
    flat = rows.reshape(len(rows), -1)
    shares = None if basis is None else flat @ basis[:, box[0], box[1]].reshape(len(basis), -1).T
    return Products(box, np.ascontiguousarray(flat, np.float32), shares)


def summed(
    observations: Observations,
    view: MeasuredView,
    halves: Iterable[tuple[int, ObservationModel]],
    changes: Sequence[np.ndarray],
    shown: np.ndarray,
    series: np.ndarray,
) -> np.ndarray:
    """[B, 2, F, K]: E·Jᵀ W (1 − Q Qᵀ W)(d_f − Σ_r series[r, f] shown[r]) of B bodies, whose J E are `changes`.

    halves: of `MeasuredView.models`; shown [R, H, W, 3] and series [R, F] as in `residuals.leftover`.
    """
    frames = view.frames.rows
    ready = []
    for half, model in halves:
        basis = None if model.projection is None else model.projection.basis()
        weights = np.ones(view.mean.shape[:2], np.float32) if model.weights is None else model.weights
        own = [products_of(c, weights, basis) for c in changes]
        columns = None if basis is None else (basis * weights[..., None]).reshape(len(basis), -1)
        ready.append((half, own, columns))
    out = np.zeros((len(changes), HALVES, len(frames), len(changes[0])))
    for first in range(0, len(frames), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        raw = observations.pictures.strips(frames[some].tolist())
        left = over_white(raw(slice(None)), observations.pictures.maximum)
        left -= view.mean
        _add(out[:, :, some], left, ready)
    known = np.zeros((len(changes), HALVES, len(shown), len(changes[0])))
    _add(known, shown, ready)
    return out - np.einsum("bhrk,rf->bhfk", known, series)


def _add(
    out: np.ndarray, pictures: np.ndarray, ready: Sequence[tuple[int, list[Products], np.ndarray | None]]
) -> None:
    """Adds to out [B, 2, F, K] the products with pictures [F, H, W, 3]."""
    if not len(pictures):
        return
    flat = pictures.reshape(len(pictures), -1)
    for half, own, columns in ready:
        coefficients = None if columns is None else flat @ columns.T
        for b, p in enumerate(own):
            out[b, half] += pictures[:, p.box[0], p.box[1]].reshape(len(pictures), -1) @ p.rows.T
            if coefficients is not None and p.shares is not None:
                out[b, half] -= coefficients @ p.shares.T
