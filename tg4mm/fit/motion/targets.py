"""Target images: a few images per view, each the product of the view's pictures with a function of time.

Displacements of less than a pixel change a picture in proportion, so the frames of a fixed camera contain no more
information than their products with the functions of time of the motion. With Ψ_v the orthonormal functions on which
view v is projected, its target images are y_v = (I − mean) Ψ_v and the model is y_v = J_v (C_v x): x is one
displacement field for each of R shared functions of time, and the mixing matrix C_v (`Problem.mixing`) expresses these
in Ψ_v. `temporal/` chooses the functions.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.core.memory import mapped_zeros, release
from tg4mm.fit.motion.nuisance.fixed_cameras import PictureSums
from tg4mm.fit.motion.nuisance.projection import Nuisance, without
from tg4mm.fit.motion.observation_model import project
from tg4mm.fit.motion.observations import Observations, watched

_IMAGES = 4  # of one view that are worked on together


@dataclass(frozen=True)
class TargetImages:
    """Products of V views' pictures with R functions of time. If C_v is the identity, Ψ_v is the basis."""

    # [R, T] float64, functions of time; orthonormal, of zero mean, where C_v is the identity
    basis: np.ndarray
    energy: np.ndarray  # [T] float64, squared pixel values in every component, kept or not
    images: np.ndarray  # [V, ρ, H, W, 3] float32, `mapped_zeros`; ρ = R where C_v is the identity
    residual_energy: np.ndarray  # [V, H, W] float32 of what was not kept, mean over channels
    rank: int  # of what residual and images hold together, functions of time
    mean: np.ndarray  # [V, H, W, 3] float32, over time and over white
    n_known: int = 0  # of the functions, the first: known before to be motion

    def of(self, v: int, rows: slice | np.ndarray = slice(None)) -> np.ndarray:
        """Return [r, H, W, 3] in memory: some of view v's images."""
        out = np.array(self.images[v, rows])
        release(self.images)
        return out


def projected(
    observations: Observations, sums: PictureSums, nuisances: Sequence[Nuisance], bases: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Every view's products [V, ρ, H, W, 3] with its functions of time [ρ, F], and the energy [V, H, W] left.

    What the active nuisance columns explain is taken out.
    """
    width, height = observations.size
    images = mapped_zeros((len(bases), len(bases[0]), height, width, 3))
    total = np.stack(
        [
            t - n.energy(m, c)
            for t, n, m, c in zip(sums.total, nuisances, sums.mean, sums.columns, strict=True)
        ]
    )
    for v, frames, pictures in watched("pictures, second pass", observations):
        basis = bases[v]
        for rows, strip in pictures:
            strip -= sums.mean[v, rows]
            images[v, :, rows] = project(frames, height, rows, strip, basis)
        for first in range(0, len(basis), _IMAGES):
            some = slice(first, first + _IMAGES)
            images[v, some] = without(nuisances[v], sums.mean[v], images[v, some])
            for image in images[v, some]:
                total[v] -= np.einsum("hwc,hwc->hw", image, image) / 3
            release(images)
        nuisances[v].release()
    return images, np.maximum(total, 0, out=total)
