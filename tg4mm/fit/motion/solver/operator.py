"""Interface between the solver and a motion problem, implemented for the CPU and for torch devices.

Find R fields x_r [4N, 3], displacement and its gradient, that explain the target images of V views. They minimise

    Σ_v Σ_pixels W |(1 − Q Qᵀ W) (J_v Σ_r C_v[:, r] m(x_r) − y_v)|²  +  h Σ_r (λ x_r·K x_r + μ |x_r|²),

where m is the motion of a field (displacement and rotation), y_v the target images and C_v their mixing matrix
(`temporal/`), W weights of pixels, Q the nuisance columns (`nuisance/projection.py`), K the prior's matrix
(`prior.py`), and h the mean over Gaussians of the diagonal of JᵀWJ, so that λ and μ do not depend on size,
contrast or number of the images. The unknowns are θ [R, P, 3] with x = B θ (`preconditioner.py`), for which conjugate
gradients need few iterations.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tg4mm.fit.motion.prior import NeighbourGraph

Array = Any  # np.ndarray or Tensor; an operator takes and gives one kind


@dataclass(frozen=True, eq=False)  # one fold is equal to itself alone
class Fold:
    """Views that are fitted together, and which of their pixels: all, or what a mask leaves."""

    views: np.ndarray  # [v] int
    pixels: np.ndarray | None = None  # [H, W] float32, 0 or 1; None: all

    def weighted(self, weights: np.ndarray | None) -> np.ndarray | None:
        """Pixel weights [v, H, W] of these views, of weights [V, H, W] or None for 1."""
        of_views = None if weights is None else weights[self.views]
        if self.pixels is None:
            return of_views
        if of_views is None:
            return np.repeat(self.pixels[None], len(self.views), 0)
        return of_views * self.pixels


class System(Protocol):
    """Symmetric positive equations in θ [R, …] for conjugate gradients."""

    @property
    def is_coupled(self) -> bool:
        """Return whether the R parts of θ are one system, not R."""

    def products(self, theta: Array, rows: Sequence[int] | None = None) -> Array:
        """The operator applied to θ; of uncoupled systems to some rows of it."""


class Operator(System, Protocol):
    """The normal equations of one fold, as products. `theta` and what comes back are [R, P, 3].

    A mixing matrix couples the R fields.
    """

    @property
    def smoothness_weight(self) -> float:
        """λ."""

    def right_hand_sides(self, pictures: Iterable[np.ndarray]) -> Array:
        """Jᵀ W of target images, of each view [ρ, H, W, 3], as [R, P, 3]."""

    def fields(self, theta: Array) -> np.ndarray:
        """θ -> [R, N, 6] float32: displacement (scene units) and rotation vector (radians)."""

    def gradient_fields(self, theta: Array) -> np.ndarray:
        """θ -> x [R, 4N, 3] float32: displacement and its gradient."""

    def prior_products(self, x: np.ndarray) -> Array:
        """Return the prior's part of `products` for fields x [R, 4N, 3]."""

    def misfit(self, fields: np.ndarray, pictures: Iterable[np.ndarray]) -> float:
        """The weighted squares that fields [R, N, 6] leave of target images."""

    def with_graph(self, graph: NeighbourGraph) -> "Operator":
        """The problem with other edge weights, in the same unknowns."""
