"""Timesteps at which things stand nearly alike, taken together: rendered, compared and linearised once.

A vibration passes the same few places over and over. Timesteps between which nothing moves by more than a fraction of
a pixel are one state, whose picture is the mean of theirs, so that the cost of a Gauss-Newton iteration goes by states
and not by timesteps, and noise is averaged besides.

A mode smaller than that, beside a large one, is averaged out of all states. What it changes in the pictures stays here
as target images, less what the states' pictures hold of them, and is small enough to be explained linearly: from the
capture itself in each iteration, and not from what the iteration before found, which every iteration would smooth once
more.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.cluster.hierarchy import fcluster, linkage

from tg4mm.core.memory import mapped_zeros, release
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import moved
from tg4mm.fit.motion.observations import Observations, PosedFrames, strips
from tg4mm.fit.motion.refine import MovedPictures
from tg4mm.fit.motion.targets import TargetImages
from tg4mm.fit.space.view import render_view

STATE_PX = 0.1  # timesteps between which nothing moves by more are one state
MOST = 24  # states, and fewer where their pictures would take more than
PICTURE_BYTES = 1 << 30


@dataclass(frozen=True)
class States:
    """K states of T timesteps."""

    of: np.ndarray  # [T] 0 … K − 1
    gains: np.ndarray  # [K, R] float64, mean of a_r(t) over each state's timesteps
    products: np.ndarray  # [K, R, R] float64, sum of a(t) a(t)ᵀ over them: changes within a state count, too

    @property
    def count(self) -> np.ndarray:
        """[K] float64, timesteps of each state."""
        return np.bincount(self.of, minlength=len(self.gains)).astype(np.float64)

    @property
    def sums(self) -> np.ndarray:
        """[K, R] float64, sum of a_r(t) over each state's timesteps."""
        return self.gains * self.count[:, None]


def states_of(
    basis: np.ndarray, pixels: np.ndarray, most: int = MOST, diameter_px: float = STATE_PX
) -> States:
    """At most `most` states of functions of time [R, T], each worth so many `pixels` [R] of motion.

    `diameter_px`: what moves at most between timesteps of one state, unless there would be more states than that.
    """
    places = basis.T * pixels
    if len(places) < 2:
        labels = np.zeros(len(places), np.int64)
    else:
        tree = linkage(places, "complete")
        labels = fcluster(tree, diameter_px, "distance")
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
    """[V, K, H, W, 3] float32 (`mapped_zeros`): mean over the timesteps of each state, by camera, over white."""
    width, height = observations.size
    share = np.zeros((len(states.gains), len(states.of)), np.float32)
    share[states.of, np.arange(len(states.of))] = 1 / states.count[states.of]
    out = mapped_zeros((len(observations.frames), len(states.gains), height, width, 3))
    for v, frames in enumerate(observations.frames):
        for rows, strip in strips(observations.pictures, frames):
            flat = share @ strip.reshape(len(strip), -1)
            out[v, :, rows] = flat.reshape(len(flat), *strip.shape[1:])
        release(out)
    return out


_ROWS = 64  # of a picture at a time, where pictures are combined


@dataclass(frozen=True)
class Errors:
    """Σ over timesteps, pixels and channels of squared differences of states' pictures."""

    changes: float  # each picture less its mean over time, which holds what stands still
    total: float

    def is_no_larger(self, other: "Errors") -> bool:
        """Whether neither sum is larger."""
        return self.changes <= other.changes and self.total <= other.total


@dataclass(frozen=True)
class StateObservations:
    """The pictures of K states and R components in V synchronous cameras."""

    cameras: list[PosedFrames]
    states: States
    pictures: np.ndarray  # [V, K, H, W, 3] float32 over white
    changes_within: np.ndarray  # [V, R, H, W, 3] float32: target images of the changes within states

    @staticmethod
    def of(
        observations: Observations, states: States, targets: TargetImages, used: np.ndarray
    ) -> "StateObservations":
        """`used` [R]: which of the target images belong to the functions of time of `states`."""
        pictures = state_pictures(observations, states)
        changes_within = mapped_zeros((len(pictures), len(used), *pictures.shape[2:]))
        for v, seen in enumerate(pictures):
            changes_within[v] = targets.of(v, used)
            _add(changes_within[v], -states.sums.T, seen)
            release(changes_within)
            release(pictures)
        return StateObservations(observations.frames, states, pictures, changes_within)

    def moved(self, fields: np.ndarray) -> MovedPictures:
        """With the motion of fields [R, N, 6]."""
        motions = np.tensordot(self.states.gains, fields, 1).astype(np.float32)
        return MovedPictures(self.cameras, self.pictures, motions, self.states.of)

    def residuals(self, gaussians: Gaussians, fields: np.ndarray, device: str) -> tuple[np.ndarray, Errors]:
        """[V, K, H, W, 3]: pictures less what is rendered, each less its mean over time; and how much that is."""
        out = rendered(gaussians, self.moved(fields), device)
        share = (self.states.count / self.states.count.sum()).astype(np.float32)
        total = changes = 0.0
        for of_camera, seen in zip(out, self.pictures, strict=True):
            np.subtract(seen, of_camera, out=of_camera)
            total += self._squares(of_camera)
            of_camera -= np.tensordot(share, of_camera, 1)
            changes += self._squares(of_camera)
            release(out)
            release(self.pictures)
        return out, Errors(changes, total)

    def _squares(self, of_camera: np.ndarray) -> float:
        squares = [float(np.einsum("hwc,hwc->", s, s, dtype=np.float64)) for s in of_camera]
        return float(squares @ self.states.count)

    def target_images(self, v: int, residuals: np.ndarray, own: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """[R, H, W, 3]: camera v's target images that the motion explains, of the states `own` where it was linearised.

        residuals: of `residuals`. shown [R, H, W, 3]: what the motion found so far changes there, for gains of 1. What
        changes within states is taken as spread evenly over time.
        """
        sums = self.states.sums[own]
        mix = (sums.T @ self.states.gains[own]).astype(np.float32)
        share = np.float32(self.states.count[own].sum() / self.states.count.sum())
        changes = np.asarray(share * self.changes_within[v])
        mixed = np.zeros((sums.shape[1], len(residuals[v])))
        mixed[:, own] = sums.T
        _add(changes, mixed, residuals[v])
        _add(changes, mix, shown)
        release(self.changes_within)
        release(residuals)
        return changes


def _add(images: np.ndarray, matrix: np.ndarray, pictures: np.ndarray) -> None:
    """Adds matrix [R, K] times pictures [K, H, W, 3] to images [R, H, W, 3], some rows of them at a time."""
    matrix = matrix.astype(np.float32)
    for top in range(0, images.shape[1], _ROWS):
        rows = slice(top, top + _ROWS)
        images[:, rows] += np.tensordot(matrix, pictures[:, rows], 1)


@torch.no_grad()
def rendered(gaussians: Gaussians, seen: MovedPictures, device: str) -> np.ndarray:
    """[V, K, H, W, 3] float32 (`mapped_zeros`): what cameras see of the Gaussians moved to every state, over white."""
    height, width = seen.pictures.shape[2:4]
    there, out = gaussians.to(device), mapped_zeros(seen.pictures.shape)
    cameras = [[torch.from_numpy(a).to(device) for a in (c.viewmat, c.K)] for c in seen.cameras]
    for k, motion in enumerate(seen.motions):
        g = moved(there, torch.from_numpy(motion).to(device))
        for v, (viewmat, K) in enumerate(cameras):
            view = render_view(g, viewmat, K, (width, height), g.sh_degree, seen.cameras[v].low_pass)
            out[v, k] = view.rgb.cpu().numpy()
            release(out)
    return out
