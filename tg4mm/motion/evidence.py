"""What Gauss-Newton iterations compare with: every state's pictures, and the changes within states.

A state's picture is the mean over timesteps between which nothing moves by much. A mode smaller than that, beside a
large one, is averaged out of all states. What it changes in the pictures stays here as target images, less what the
states' pictures hold of them, and is small enough to be explained linearly: from the capture itself in each iteration,
and not from what the iteration before found, which every iteration would smooth once more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from tg4mm.gaussians import Gaussians
from tg4mm.motion.observations import Observations, PosedFrames
from tg4mm.motion.refine import MovedPictures, at_state
from tg4mm.motion.states import States, state_pictures
from tg4mm.motion.temporal import TargetImages
from tg4mm.rasterize import rasterization
from tg4mm.room import release, room

_ROWS = 64  # of a picture at a time, where pictures are combined


@dataclass(frozen=True)
class Errors:
    """Σ over timesteps, pixels and channels of squared differences of states' pictures."""

    changes: float  # each picture less its mean over time, which holds what stands still
    whole: float

    def within(self, other: Errors) -> bool:
        """Whether neither is larger."""
        return self.changes <= other.changes and self.whole <= other.whole


@dataclass(frozen=True)
class Evidence:
    """Of K states and R components in V synchronous cameras."""

    cameras: list[PosedFrames]
    states: States
    pictures: np.ndarray  # [V, K, H, W, 3] float32 over white
    within: np.ndarray  # [V, R, H, W, 3] float32: target images of the changes within states

    @staticmethod
    def of(observations: Observations, states: States, targets: TargetImages, used: np.ndarray) -> Evidence:
        """`used` [R]: which of the target images belong to the functions of time of `states`."""
        pictures = state_pictures(observations, states)
        within = room((len(pictures), len(used), *pictures.shape[2:]))
        for v, seen in enumerate(pictures):
            within[v] = targets.of(v, used)
            _add(within[v], -states.sums.T, seen)
            release(within)
            release(pictures)
        return Evidence(observations.frames, states, pictures, within)

    def moved(self, fields: np.ndarray) -> MovedPictures:
        """With the motion of fields [R, N, 6]."""
        motions = np.tensordot(self.states.gains, fields, 1).astype(np.float32)
        return MovedPictures(self.cameras, self.pictures, motions, self.states.of)

    def remaining(self, gaussians: Gaussians, fields: np.ndarray, device: str) -> tuple[np.ndarray, Errors]:
        """[V, K, H, W, 3]: pictures less what is rendered, each less its mean over time; and how much that is."""
        left = rendered(gaussians, self.moved(fields), device)
        share = (self.states.count / self.states.count.sum()).astype(np.float32)
        whole = changes = 0.0
        for of_camera, seen in zip(left, self.pictures, strict=True):
            np.subtract(seen, of_camera, out=of_camera)
            whole += self._squares(of_camera)
            of_camera -= np.tensordot(share, of_camera, 1)
            changes += self._squares(of_camera)
            release(left)
            release(self.pictures)
        return left, Errors(changes, whole)

    def _squares(self, of_camera: np.ndarray) -> float:
        squares = [float(np.einsum("hwc,hwc->", s, s, dtype=np.float64)) for s in of_camera]
        return float(squares @ self.states.count)

    def target(self, v: int, left: np.ndarray, own: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """[R, H, W, 3]: camera v's target images that the motion explains, of the states `own` where it was linearised.

        left: of `remaining`. shown [R, H, W, 3]: what the motion found so far changes there, for gains of 1. What
        changes within states is taken as spread evenly over time.
        """
        sums = self.states.sums[own]
        mix = (sums.T @ self.states.gains[own]).astype(np.float32)
        share = np.float32(self.states.count[own].sum() / self.states.count.sum())
        changes = np.asarray(share * self.within[v])
        mixed = np.zeros((sums.shape[1], len(left[v])))
        mixed[:, own] = sums.T
        _add(changes, mixed, left[v])
        _add(changes, mix, shown)
        release(self.within)
        release(left)
        return changes


def _add(images: np.ndarray, matrix: np.ndarray, pictures: np.ndarray) -> None:
    """Adds matrix [R, K] times pictures [K, H, W, 3] to images [R, H, W, 3], some rows of them at a time."""
    matrix = matrix.astype(np.float32)
    for top in range(0, images.shape[1], _ROWS):
        rows = slice(top, top + _ROWS)
        images[:, rows] += np.tensordot(matrix, pictures[:, rows], 1)


@torch.no_grad()
def rendered(gaussians: Gaussians, seen: MovedPictures, device: str) -> np.ndarray:
    """[V, K, H, W, 3] float32 (`room`): what the cameras see of the Gaussians moved to every state, over white."""
    height, width = seen.pictures.shape[2:4]
    there = gaussians.to(device)
    viewmats, Ks = (
        torch.from_numpy(np.stack([getattr(c, name) for c in seen.cameras])).to(device)
        for name in ("viewmat", "K")
    )
    out = room(seen.pictures.shape)
    for k, motion in enumerate(seen.motions):
        g = at_state(there, torch.from_numpy(motion).to(device))
        for v in range(len(viewmats)):
            rgb, _, _ = rasterization(
                g.means, g.quats, g.scales, g.opacities, g.sh, viewmats[v : v + 1], Ks[v : v + 1],
                width, height, sh_degree=g.sh_degree, backgrounds=torch.ones(1, 3, device=device),
            )  # fmt: skip
            out[v, k] = rgb[0].cpu().numpy()
            release(out)
    return out
