"""What two halves of the cameras agree on: components of noise fade, and every Gaussian gets an uncertainty.

Noise of rendering or of a sensor is another in every camera, motion is the same in all. So the cameras are fitted in
two halves, the prior half as strong in each, which costs as much as one fit to all of them. Where the halves' fields
a and b agree, their mean u is kept; where they do not, it is drawn to zero, by the gain that brings it nearest to the
truth on average (Wiener's): Σ a·b / Σ |u|², one for each temporal component. What the prior does wrong is wrong alike
in both halves and stays.
"""

from __future__ import annotations

import numpy as np

LEAST = 6  # cameras: fewer than three in a half do not hold a field in space
_AT_ONCE = 1 << 14  # Gaussians whose neighbourhoods are averaged together


def halves(n_cameras: int) -> list[np.ndarray]:
    """Every second camera and the others, so that both see all sides; none with fewer than `LEAST` cameras."""
    rows = np.arange(n_cameras)
    return [rows[::2], rows[1::2]] if n_cameras >= LEAST else []


def agreed_gain(whole: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[R] float32, 0 to 1: what to multiply R fields [R, N, 3] by, the means of those fitted to one half each."""
    both = np.einsum("rnc,rnc->r", a, b, dtype=np.float64)
    power = np.einsum("rnc,rnc->r", whole, whole, dtype=np.float64)
    return np.clip(both / np.maximum(power, np.finfo(np.float32).tiny), 0, 1).astype(np.float32)


def agreed_fields(fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What fields [P, R, N, DOF] of all cameras or of two halves agree on: [R, N, DOF], and gains [R]."""
    if len(fields) == 1:
        return fields[0], np.ones(fields.shape[1], np.float32)
    whole = (fields[0] + fields[1]) / 2
    gain = agreed_gain(whole[..., :3], fields[0][..., :3], fields[1][..., :3])
    return whole * gain[:, None, None], gain


def deviation(a: np.ndarray, b: np.ndarray, around: np.ndarray) -> np.ndarray:
    """[N] float32, scene units: the standard deviation of the noise in R fields together, from the halves [R, N, 3].

    Rms over the Gaussians `around` each [N, count]; of vectors' lengths, root of the sum over components,
    before any gain. Errors that all cameras share are not in it.
    """
    spread = np.einsum("rnc,rnc->n", a - b, a - b) / 4
    return np.sqrt(mean_around(spread, around)).astype(np.float32)


def mean_around(values: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Of values [N, …], the mean over the Gaussians `around` each [N, count], as `Graph.knn` lists them."""
    out = np.empty_like(values)
    for first in range(0, len(values), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        out[some] = values[around[some]].mean(1)
    return out
