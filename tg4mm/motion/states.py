"""Timesteps at which things stand nearly alike, taken together: rendered, compared and linearised once.

A vibration passes the same few places over and over. Timesteps between which nothing moves by more than a fraction of
a pixel are one state, whose picture is the mean of theirs, so that the cost of a Gauss-Newton iteration goes by states
and not by timesteps, and noise is averaged besides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from tg4mm.motion.observations import Observations, strips
from tg4mm.room import release, room

ALIKE_PX = 0.1  # timesteps that differ by less are one state
MOST = 24  # states, and fewer where their pictures would take more than
PICTURE_BYTES = 1 << 30


@dataclass(frozen=True)
class States:
    """K states of T timesteps."""

    of: np.ndarray  # [T] 0 … K − 1
    gains: np.ndarray  # [K, R] float64, mean of a_r(t) over each state's timesteps
    products: (
        np.ndarray
    )  # [K, R, R] float64, sum of a(t) a(t)ᵀ over them: what differs within a state counts, too

    @property
    def count(self) -> np.ndarray:
        """[K] float64, timesteps of each state."""
        return np.bincount(self.of, minlength=len(self.gains)).astype(np.float64)

    @property
    def sums(self) -> np.ndarray:
        """[K, R] float64, sum of a_r(t) over each state's timesteps."""
        return self.gains * self.count[:, None]


def states_of(basis: np.ndarray, pixels: np.ndarray, most: int = MOST, alike: float = ALIKE_PX) -> States:
    """At most `most` states of functions of time [R, T], each worth so many `pixels` [R] of motion."""
    places = basis.T * pixels
    if len(places) < 2:
        labels = np.zeros(len(places), np.int64)
    else:
        tree = linkage(places, "complete")
        labels = fcluster(tree, alike, "distance")
        if labels.max() > most:
            labels = fcluster(tree, most, "maxclust")
        labels = np.unique(labels, return_inverse=True)[1]
    return labelled(basis, labels)


def labelled(basis: np.ndarray, labels: np.ndarray) -> States:
    """The states that `labels` [T] of 0 … K − 1 tell apart."""
    count = np.bincount(labels)
    sums = np.zeros((len(count), len(basis)))
    np.add.at(sums, labels, basis.T)
    products = np.zeros((len(count), len(basis), len(basis)))
    np.add.at(products, labels, np.einsum("rt,qt->trq", basis, basis))
    return States(labels, sums / count[:, None], products)


def most_states(n_views: int, size: tuple[int, int]) -> int:
    """How many states' pictures of `n_views` cameras of (width, height) fit in `PICTURE_BYTES`: 3 to `MOST`."""
    return int(np.clip(PICTURE_BYTES // (12 * n_views * size[0] * size[1]), 3, MOST))


def state_pictures(observations: Observations, states: States) -> np.ndarray:
    """[V, K, H, W, 3] float32 (`room`): mean over the timesteps of each state, by camera, over white."""
    width, height = observations.size
    share = np.zeros((len(states.gains), len(states.of)), np.float32)
    share[states.of, np.arange(len(states.of))] = 1 / states.count[states.of]
    out = room((len(observations.frames), len(states.gains), height, width, 3))
    for v, frames in enumerate(observations.frames):
        for rows, strip in strips(observations.pictures, frames):
            flat = share @ strip.reshape(len(strip), -1)
            out[v, :, rows] = flat.reshape(len(flat), *strip.shape[1:])
        release(out)
    return out
