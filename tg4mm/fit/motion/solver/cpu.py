"""The motion problem on the CPU: numba kernels for the Jacobian and the prior, numpy for the rest."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tg4mm.core.memory import Buffers
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian
from tg4mm.fit.motion.nuisance.projection import Projection
from tg4mm.fit.motion.prior import NeighbourGraph
from tg4mm.fit.motion.solver.preconditioner import MultilevelPreconditioner
from tg4mm.fit.rasterize.kernels.compiled import on_each

AT_ONCE = 8  # fields in a pass over a view: half the time of eight passes; more would only take more memory


@dataclass(frozen=True)
class CpuOperator:
    """`Operator` on numpy arrays."""

    views: Sequence[ViewJacobian]
    graph: NeighbourGraph
    preconditioner: MultilevelPreconditioner
    scale: float  # h
    smoothness_weight: float
    ridge: float
    weights: np.ndarray | None = None  # W [V, H, W] float32; None: 1
    projections: Sequence[Projection] | None = None  # one a view; None: nothing is projected out
    mixing: Sequence[np.ndarray] | None = None  # C_v [ρ, R]; None: the identity
    support: np.ndarray | None = None  # [R, N] float32: 1 where a field may move a Gaussian, else 0; None: 1
    buffers: Buffers = field(default_factory=Buffers, compare=False)

    @property
    def is_coupled(self) -> bool:
        return self.mixing is not None

    def right_hand_sides(self, pictures: Iterable[np.ndarray]) -> np.ndarray:
        """`Operator.right_hand_sides`."""
        return np.stack(on_each(self.from_motion, self.supported(self.gathered(pictures))))

    def gathered(self, pictures: Iterable[np.ndarray]) -> np.ndarray:
        """Return [R, N, 6]: Σ_v C_vᵀ Jᵀ W of target images."""
        out: np.ndarray | None = None
        one_by_one = iter(pictures)
        for k, view in enumerate(self.views):
            seen = next(one_by_one)
            v_motions = np.zeros((len(seen), self.graph.n_gaussians, DOF), np.float32)
            for some in _at_once(len(v_motions)):
                shown = seen[some]
                if self.projections is not None:
                    shown = self.projections[k].out_of(shown)
                if self.weights is not None:
                    shown = shown * self.weights[k, ..., None]
                view.vjp(np.ascontiguousarray(shown), v_motions[some], self.buffers)
            del seen, shown  # before the next are made
            self.release(k)
            v_motions = self._unmixed(k, v_motions)
            out = v_motions if out is None else out + v_motions
        assert out is not None
        return out

    def products(self, theta: np.ndarray, rows: Sequence[int] | None = None) -> np.ndarray:
        """`Operator.products`."""
        return products_of([self], [theta if rows is None else theta[list(rows)]])[0]

    def fields(self, theta: np.ndarray) -> np.ndarray:
        """`Operator.fields`."""
        return self.supported(np.stack(on_each(lambda one: self.field_and_motion(one)[1], theta)))

    def gradient_fields(self, theta: np.ndarray) -> np.ndarray:
        """`Operator.gradient_fields`."""
        return np.stack(on_each(self.preconditioner.field, theta))

    def prior_products(self, x: np.ndarray) -> np.ndarray:
        """`Operator.prior_products`."""
        nothing = np.zeros((self.graph.n_gaussians, DOF), np.float32)
        return np.stack(on_each(lambda one: self.with_prior(one, nothing), x))

    def field_and_motion(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the field [4N, 3] that θ [P, 3] stands for, and its motion [N, 6]."""
        x = self.preconditioner.field(theta)
        return x, self.graph.motion(x)

    def from_motion(self, v_motion: np.ndarray) -> np.ndarray:
        """Return [P, 3]: the transpose of the map from θ to motion, applied to [N, 6]."""
        return self.preconditioner.from_field(self.graph.from_motion(v_motion))

    def with_prior(self, x: np.ndarray, v_motion: np.ndarray) -> np.ndarray:
        """Return [P, 3]: the operator on a field x [4N, 3], given JᵀWJ of its motion [N, 6]."""
        v = self.graph.from_motion(v_motion)
        self.graph.add_prior(x, self.scale * self.smoothness_weight, self.scale * self.ridge, v)
        return self.preconditioner.from_field(v)

    def misfit(self, fields: np.ndarray, pictures: Iterable[np.ndarray]) -> float:
        """`Operator.misfit`."""
        total = 0.0
        for k, (view, shown) in enumerate(zip(self.views, pictures, strict=True)):
            residual = view.jvp(self.mixed(k, fields), self.buffers) - shown
            if self.projections is not None:
                residual = self.projections[k].out_of(residual)
            self.release(k)
            weighted = residual if self.weights is None else residual * self.weights[k, ..., None]
            total += float(np.vdot(residual.astype(np.float64), weighted))
        return total

    def with_graph(self, graph: NeighbourGraph) -> "CpuOperator":
        """`Operator.with_graph`."""
        return replace(self, graph=graph)

    def mixed(self, k: int, fields: np.ndarray) -> np.ndarray:
        """Return fields [R, N, 6] as view k's target images show them, [ρ, N, 6]."""
        if self.mixing is None:
            return np.ascontiguousarray(fields)
        return np.tensordot(self.mixing[k], fields, 1)

    def release(self, k: int) -> None:
        """Let go of what a call has read of view k, where that lies in a file."""
        self.views[k].release()
        if self.projections is not None:
            self.projections[k].release()

    def supported(self, motions: np.ndarray) -> np.ndarray:
        """Motions [R, N, 6] of the fields, 0 outside their support."""
        return motions if self.support is None else motions * self.support[..., None]

    def add_view(self, k: int, motions: np.ndarray, v_motions: np.ndarray) -> None:
        """Add C_vᵀ Jᵀ W (1 − Q Qᵀ W) J C_v of view k to `v_motions`, both [S, R, N, 6] of S systems."""
        shown = motions if self.mixing is None else np.stack([self.mixed(k, motion) for motion in motions])
        flat, alone = shown.reshape(-1, *shown.shape[2:]), self.mixing is None and self.projections is None
        out = v_motions.reshape(flat.shape) if alone else np.zeros_like(flat)
        for some in _at_once(len(flat)):
            weights = None if self.weights is None else self.weights[k]
            self.views[k].gauss_newton_product(flat[some], weights, out[some], self.buffers)
        if self.projections is not None:
            self.projections[k].correct(flat, out)
        self.release(k)
        if not alone:
            for total, motion in zip(v_motions, out.reshape(shown.shape), strict=True):
                total += self._unmixed(k, motion)

    def _unmixed(self, k: int, v_motions: np.ndarray) -> np.ndarray:
        return v_motions if self.mixing is None else np.tensordot(self.mixing[k].T, v_motions, 1)


def products_of(operators: Sequence[CpuOperator], thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Products of operators that share views, weights and mixing with θ [R, P, 3] of each, in one pass over views."""
    n = len(thetas[0])
    each = [(o, one) for o, theta in zip(operators, thetas, strict=True) for one in theta]
    x, moved = zip(*on_each(lambda pair: pair[0].field_and_motion(pair[1]), each), strict=True)
    motions = np.stack([o.supported(np.stack(moved[k * n : (k + 1) * n])) for k, o in enumerate(operators)])
    v_motions = np.zeros_like(motions)
    for k in range(len(operators[0].views)):
        operators[0].add_view(k, motions, v_motions)
    supported = [v for o, v_own in zip(operators, v_motions, strict=True) for v in o.supported(v_own)]

    def product(i: int) -> np.ndarray:
        return each[i][0].with_prior(x[i], supported[i])

    products = on_each(product, range(len(each)))
    return [np.stack(products[k * n : (k + 1) * n]) for k in range(len(operators))]


def _at_once(n: int) -> list[slice]:
    """Return how many of n fields share a pass over a view."""
    return [slice(a, min(a + AT_ONCE, n)) for a in range(0, n, AT_ONCE)]


@dataclass(frozen=True)
class SharedPass:
    """Operators that share views and weights as one block-diagonal operator: one pass over the views for all of them.

    θ holds the R fields of the first operator, then those of the second … Each operator is a system of its own.
    """

    operators: Sequence[CpuOperator]

    @property
    def is_coupled(self) -> bool:
        """The operators are not."""
        return False

    def right_hand_sides(self, pictures: Iterable[np.ndarray]) -> np.ndarray:
        """Concatenate the right-hand sides of all operators."""
        gathered = self.operators[0].gathered(pictures)
        return np.stack([b for o in self.operators for b in on_each(o.from_motion, gathered)])

    def products(self, theta: np.ndarray, rows: Sequence[int] | None = None) -> np.ndarray:
        """`Operator.products`; `rows` of whole operators."""
        n = len(theta) // len(self.operators)
        active = range(len(self.operators)) if rows is None else sorted({r // n for r in rows})
        products = products_of(
            [self.operators[k] for k in active], [theta[k * n : (k + 1) * n] for k in active]
        )
        images = np.concatenate(products)
        if rows is None:
            return images
        places = {r: i for i, r in enumerate(k * n + j for k in active for j in range(n))}
        return images[[places[r] for r in rows]]
