"""Sensors' equations straight from the pictures, for a capture of which one call measures a few of them.

A sensor needs of a frame E·Jᵀ W (1 − Q Qᵀ W) d_f alone: products of the frame's change d_f with the pictures of its K
motions, J E, weighted, and with the nuisance columns Q. That is a hundredth of the work of pulling d_f back to all
Gaussians (`residuals.py`), with the same result; other sensors read the pictures again.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.capture.pictures import over_white
from tg4mm.fit.motion.observation_model import ObservationModel, later
from tg4mm.fit.motion.observations import Observations
from tg4mm.show.measure.residuals import AT_ONCE, MeasuredView
from tg4mm.show.measure.rows import Band, bands_of, by_band
from tg4mm.show.measure.sides import HALVES

Box = tuple[slice, slice]


@dataclass(frozen=True)
class Products:
    """What of a frame's change one body needs in one half of one view's data, of one band of its rows."""

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


def products_of(
    changes: np.ndarray, weights: np.ndarray, basis: np.ndarray | None, bands: Sequence[Band]
) -> list[Products]:
    """Of J E [K, H, W, 3] with weights [H, W] and the basis Q [k, H, W, 3], for every band."""
    down, right = boxed(changes)
    rows = changes[:, down, right] * weights[down, right][..., None]
    flat, shares = rows.reshape(len(rows), -1), None
    if basis is not None:
        shares = flat @ basis[:, down, right].reshape(len(basis), -1).T
    out = []
    for band in bands:
        first, last = (
            int(np.clip(edge, down.start, down.stop)) for edge in (band.rows.start, band.rows.stop)
        )
        own = rows[:, first - down.start : last - down.start].reshape(len(rows), -1)
        out.append(Products((slice(first, last), right), np.ascontiguousarray(own, np.float32), shares))
    return out


def delay_of(changes: np.ndarray, weights: np.ndarray, bands: Sequence[Band]) -> float:
    """Seconds after a frame's time at which its rows tell of a body: their mean, each by what it says, J E² W."""
    said = [float(np.einsum("khwc,hw->", changes[:, b.rows] ** 2, weights[b.rows])) for b in bands]
    return float(np.average([b.delay_s for b in bands], weights=said)) if sum(said) > 0 else 0.0


def summed(
    observations: Observations,
    view: MeasuredView,
    halves: Iterable[tuple[int, ObservationModel]],
    changes: Sequence[np.ndarray],
    shown: np.ndarray,
    series: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """[B, 2, F, K]: E·Jᵀ W (1 − Q Qᵀ W)(d_f − Σ_r series[r, f] shown[r]) of B bodies, whose J E are `changes`.

    halves: of `MeasuredView.models`; shown [R, H, W, 3], series [R, F] of the frames' times. Also [B] seconds after
    these times at which each body's equations hold.
    """
    frames, times = view.frames.rows, view.frames.times_s
    bands = bands_of(view.frames, len(view.mean))
    ready = []
    for half, model in halves:
        basis = None if model.projection is None else model.projection.basis()
        weights = np.ones(view.mean.shape[:2], np.float32) if model.weights is None else model.weights
        own = list(zip(*(products_of(c, weights, basis, bands) for c in changes), strict=True))
        columns = None if basis is None else basis * weights[..., None]
        ready.append((half, own, columns))
    out = np.zeros((len(bands), len(changes), HALVES, len(frames), len(changes[0])))
    for first in range(0, len(frames), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        raw = observations.pictures.strips(frames[some].tolist())
        left = over_white(raw(slice(None)), observations.pictures.maximum)
        left -= view.mean
        _add(out[:, :, :, some], left, bands, ready)
    known = np.zeros((*out.shape[:3], len(shown), len(changes[0])))
    _add(known, shown, bands, ready)
    out -= np.einsum("dbhrk,drf->dbhfk", known, by_band(view.frames, len(view.mean), series))
    delays = np.array([delay_of(c, view.weights, bands) for c in changes])
    total = np.zeros(out.shape[1:])
    for band, said in zip(bands, out, strict=True):
        for b, delay in enumerate(delays):
            by_time = np.moveaxis(said[b], 1, -1)
            at_delay = later(times, by_time.reshape(-1, len(frames)), delay - band.delay_s)
            total[b] += np.moveaxis(at_delay.reshape(by_time.shape), -1, 1)
    return total, delays


def _add(
    out: np.ndarray,
    pictures: np.ndarray,
    bands: Sequence[Band],
    ready: Sequence[tuple[int, list[tuple[Products, ...]], np.ndarray | None]],
) -> None:
    """Adds to out [D, B, 2, F, K] of D bands the products with pictures [F, H, W, 3]."""
    if not len(pictures):
        return
    for d, band in enumerate(bands):
        flat = pictures[:, band.rows].reshape(len(pictures), -1)
        for half, own, columns in ready:
            coefficients = (
                None if columns is None else flat @ columns[:, band.rows].reshape(len(columns), -1).T
            )
            for b, p in enumerate(own[d]):
                out[d, b, half] += pictures[:, p.box[0], p.box[1]].reshape(len(pictures), -1) @ p.rows.T
                if coefficients is not None and p.shares is not None:
                    out[d, b, half] -= coefficients @ p.shares.T
