"""Appearance: the residual of the motion in the target images, as changes of the Gaussians' colour.

Two folds of the cameras are fitted, as for the motion, and their mean is multiplied by its reliability around each
Gaussian: gloss and shadows change locally. A component with an overall reliability below one half is noise, or has no
appearance, and is dropped, after one iteration if it shows by then.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix, diags

from tg4mm.core.memory import Buffers, release
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import PosedView, ViewJacobian, along_and_across, colour_jacobian
from tg4mm.fit.motion.linear_fit import Correction
from tg4mm.fit.motion.prior import NeighbourGraph
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import local_reliability, reliability
from tg4mm.fit.rasterize.kernels.compiled import kernel
from tg4mm.fit.rasterize.kernels.layout import FEAT

HARMONIC = 0.28209479177387814  # the first: times its coefficient it is a colour
_TILT = np.float32(np.sqrt(3.0))  # of degree 1 beside it
SMOOTHNESS_WEIGHT = 2.0  # λ, of neighbours that change alike; both chosen on eight generated scenes
RIDGE_WEIGHT = 0.2  # μ, which draws changes to zero
ITERATIONS = 3  # six do hardly better
LOOK = 1  # iterations after which the folds' agreement is tested; enough between the motion's two passes
_MIN_RELIABILITY = 0.5  # below it a component has none
_TOGETHER = 8  # components that share a pass over the views


@dataclass(frozen=True)
class AppearanceView:
    """One camera's picture as a linear function of changes of colour x [R, N, K, 3].

    Of K = 1 or 4 coefficients the first is the colour's mean over all directions, the others are its tilt, in units in
    which all have the same mean square over directions.
    """

    view: ViewJacobian  # its Jacobian takes "displacements" for colours
    harmonics: np.ndarray  # [N, K] float32

    def jvp(self, x: np.ndarray, buffers: Buffers) -> np.ndarray:
        """Changes of the picture [R, H, W, 3], until the next call with the same `buffers`."""
        return self.view.jvp(self._colours(x, buffers), buffers)

    def vjp(self, pictures: np.ndarray, out: np.ndarray, buffers: Buffers) -> None:
        """The transpose: adds to `out` [R, N, K, 3] the product with pictures [R, H, W, 3]."""
        v = self._nothing(out, buffers, "v_colours")
        self.view.vjp(pictures, v, buffers)
        _gather(self.harmonics, v, out)

    def gauss_newton_product(
        self, x: np.ndarray, weights: np.ndarray | None, out: np.ndarray, buffers: Buffers
    ) -> None:
        """`jvp`, times the weights of pixels [H, W] or 1, and `vjp`, in one pass."""
        v = self._nothing(out, buffers, "v_colours")
        self.view.gauss_newton_product(self._colours(x, buffers), weights, v, buffers)
        _gather(self.harmonics, v, out)

    def _colours(self, x: np.ndarray, buffers: Buffers) -> np.ndarray:
        colours = self._nothing(x, buffers, "colours")
        _spread(self.harmonics, x, colours)
        return colours

    @staticmethod
    def _nothing(x: np.ndarray, buffers: Buffers, name: str) -> np.ndarray:
        room = buffers.take(name, (x.shape[0], x.shape[1], DOF))
        room[:] = 0
        return room


def appearance_views(
    views: Sequence[ViewJacobian], cameras: Sequence[PosedView], means: np.ndarray, tilts: bool
) -> list[AppearanceView]:
    """Views of Gaussians at `means` [N, 3]; with `tilts` K is 4, else 1."""
    out = []
    for view, camera in zip(views, cameras, strict=True):
        harmonics = np.ones((len(means), 4 if tilts else 1), np.float32)
        if tilts:
            x, y, z = along_and_across(camera, means)[0].T
            harmonics[:, 1:] = _TILT * np.stack([-y, z, -x], 1)
        colours = view.splats[view.bins.order[: view.bins.n_visible], FEAT : FEAT + 3]
        # what is clamped at 0 does not change
        out.append(AppearanceView(colour_jacobian(view, colours > 0), harmonics))
    return out


@kernel
def _spread(harmonics, x, colours):
    """colours[r, n, :3] = Σ_k harmonics[n, k] x[r, n, k]."""
    for r in range(x.shape[0]):
        for n in range(x.shape[1]):
            for k in range(x.shape[2]):
                for c in range(3):
                    colours[r, n, c] += harmonics[n, k] * x[r, n, k, c]


@kernel
def _gather(harmonics, v_colours, out):
    """The transpose of `_spread`, added to `out`."""
    for r in range(out.shape[0]):
        for n in range(out.shape[1]):
            for k in range(out.shape[2]):
                for c in range(3):
                    out[r, n, k, c] += harmonics[n, k] * v_colours[r, n, c]


@dataclass(frozen=True)
class AppearanceProblem:
    """Find the change of colour x [N, K, 3] that explains pictures.

    Minimises Σ_views Σ_pixels W |A x − D|² + h (λ x·Lx + μ |x|²), with A the blending weights, L the graph's
    Laplacian (mean diagonal 1), and h the mean over Gaussians of the diagonal of AᵀWA. The unknowns θ = x √d are
    scaled by the operator's rows (d), so that what is hardly seen is found in as many iterations as the rest.
    """

    views: Sequence[AppearanceView]
    weights: np.ndarray | None  # W [V, H, W]; None: 1
    laplacian: csr_matrix  # [N, N] float32
    scale: float  # h
    root: np.ndarray  # [N, K, 1] float32, √d
    share: float = 1.0  # of the views: the prior is weaker in proportion
    is_coupled: bool = False  # the systems are independent
    buffers: Buffers = field(default_factory=Buffers, compare=False)

    @staticmethod
    def of(
        views: Sequence[AppearanceView], weights: np.ndarray | None, graph: NeighbourGraph
    ) -> "AppearanceProblem":
        laplacian = _laplacian(graph)
        seen = _rows(views, weights)
        scale = max(float(seen[:, 0].mean()), 1e-12)
        d = seen + scale * (SMOOTHNESS_WEIGHT * laplacian.diagonal()[:, None] + RIDGE_WEIGHT)
        return AppearanceProblem(views, weights, laplacian, scale, np.sqrt(d, dtype=np.float32)[..., None])

    def of_views(self, rows: np.ndarray) -> "AppearanceProblem":
        """The problem that only some of the views pose."""
        weights = None if self.weights is None else self.weights[rows]
        views, share = [self.views[i] for i in rows], len(rows) / len(self.views)
        return replace(self, views=views, weights=weights, share=share)

    def colours(self, theta: np.ndarray) -> np.ndarray:
        """x of θ, both [..., N, K, 3]."""
        return np.asarray(theta / self.root, np.float32)

    def right_hand_sides(self, pictures: Iterable[np.ndarray]) -> np.ndarray:
        """The transposed operator applied to R pictures [R, H, W, 3] of each view: [R, N, K, 3]."""
        out = np.zeros((0, *self.root.shape[:2], 3), np.float32)
        for k, (view, shown) in enumerate(zip(self.views, pictures, strict=True)):
            if not k:
                out = np.zeros((len(shown), *out.shape[1:]), np.float32)
            weighted = shown if self.weights is None else shown * self.weights[k, ..., None]
            view.vjp(weighted, out, self.buffers)
        return np.asarray(out / self.root)

    def products(self, theta: np.ndarray, rows: Sequence[int] | None = None) -> np.ndarray:
        """The symmetric operator of the problem applied to several θ [R, N, K, 3], in one pass over the views."""
        x = self.colours(theta if rows is None else theta[list(rows)])
        out = np.zeros_like(x)
        for k, view in enumerate(self.views):
            view.gauss_newton_product(x, None if self.weights is None else self.weights[k], out, self.buffers)
        strength = np.float32(self.scale * self.share)
        for one, image in zip(x, out, strict=True):
            difference = (self.laplacian @ one.reshape(len(one), -1)).reshape(one.shape)
            image += strength * (np.float32(SMOOTHNESS_WEIGHT) * difference + np.float32(RIDGE_WEIGHT) * one)
        return np.asarray(out / self.root)


def _rows(views: Sequence[AppearanceView], weights: np.ndarray | None) -> np.ndarray:
    """Return [N, K] float32: sums of the operator's rows without the prior, which are no less than its diagonal."""
    n, count = views[0].harmonics.shape
    total, buffers = np.zeros((n, count), np.float32), Buffers()
    ones = np.ones((1, n, 1, 3), np.float32)
    for k, view in enumerate(views):
        seen = np.zeros_like(ones)
        plain = replace(view, harmonics=view.harmonics[:, :1])
        plain.gauss_newton_product(ones, None if weights is None else weights[k], seen, buffers)
        total += seen[0, :, :, 0] * view.harmonics**2
    return np.maximum(total, 0)


def _laplacian(graph: NeighbourGraph) -> csr_matrix:
    """Laplacian of the graph's edges with its weights; mean diagonal 1."""
    n, weight = graph.n_gaussians, graph.edge_rows[:, 0] ** 2
    beside = csr_matrix((weight, graph.other, graph.start), shape=(n, n))
    degree = np.asarray(beside.sum(1)).ravel()
    return csr_matrix((diags(degree) - beside) / degree.mean(), dtype=np.float32)


@dataclass(frozen=True)
class MotionResidual:
    """Residual of the target images of R components after the motion."""

    problem: Problem
    pictures: np.ndarray  # [V, …, H, W, 3]
    rows: np.ndarray  # [R] which of the components
    fields: np.ndarray  # [R, N, 6], their motion

    def of(self, fold: Fold, some: np.ndarray) -> Iterator[np.ndarray]:
        """Yield [s, H, W, 3] of each view of a fold, for `some` of the R components."""
        for v in fold.views:
            targets = self.pictures[v, self.rows[some]]
            yield self.problem.residual(v, targets, self.fields[some])
            release(self.pictures)


@dataclass(frozen=True)
class AppearanceFit:
    """The search for changes of colour with two folds of the cameras."""

    problem: AppearanceProblem
    folds: Sequence[Fold]
    knn: np.ndarray  # [N, count], the nearest Gaussians of each

    @staticmethod
    def of(motion: Problem, cameras: Sequence[PosedView], folds: Sequence[Fold]) -> "AppearanceFit":
        """Build the fit beside a motion problem; folds: two halves of the cameras."""
        tilts = motion.gaussians.sh_degree > 0
        views = appearance_views(motion.views, cameras, motion.gaussians.means.numpy(), tilts)
        return AppearanceFit(
            AppearanceProblem.of(views, motion.pixel_weights, motion.graph), folds, motion.graph.knn
        )

    def between_passes(self, residual: MotionResidual) -> Correction | None:
        """Return the appearance for `LinearFit.second_pass`, by one iteration; None without appearance."""
        changes, _ = self.fitted(residual, None, LOOK)
        if not changes.any():
            return None
        return lambda p, fields, some: (self.shown(int(v), changes[some]) for v in self.folds[p].views)

    def fitted(
        self,
        residual: MotionResidual,
        update: Callable[[int], None] | None = None,
        iterations: int = ITERATIONS,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the first coefficients of spherical harmonics [R, N, K, 3] float32, and gains [R].

        A component that is dropped has gain and change 0. `update` is called with how many are done.
        """
        problems = [self.problem.of_views(fold.views) for fold in self.folds]
        changes = np.zeros((len(residual.rows), *self.problem.root.shape[:2], 3), np.float32)
        gains = np.zeros(len(changes), np.float32)
        for first in range(0, len(changes), _TOGETHER):
            some = np.arange(first, min(first + _TOGETHER, len(changes)))
            sides = [
                problem.right_hand_sides(residual.of(fold, some))
                for problem, fold in zip(problems, self.folds, strict=True)
            ]
            x, gains[some] = shared_appearance(problems, sides, self.knn, iterations)
            changes[some] = x / np.float32(HARMONIC)
            if update is not None:
                update(first + len(some))
        return changes, gains

    def shown(self, v: int, changes: np.ndarray) -> np.ndarray:
        """Return [R, H, W, 3]: the pictures in view `v` of changes [R, N, K, 3]; until the next call."""
        return self.problem.views[v].jvp(changes * np.float32(HARMONIC), self.problem.buffers)


def shared_appearance(
    problems: Sequence[AppearanceProblem],
    sides: Sequence[np.ndarray],
    knn: np.ndarray,
    iterations: int = ITERATIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of colour [R, N, K, 3] and gains [R] from the problems of two folds and R right-hand sides of each."""
    changes, gains = np.zeros_like(sides[0]), np.zeros(len(sides[0]), np.float32)
    going = np.arange(len(changes))
    for count in sorted({LOOK, iterations}):
        a, b = (
            problem.colours(pcg(problem, side[going], count, 0.0).theta)
            for problem, side in zip(problems, sides, strict=True)
        )
        mean = (a + b) / 2
        gain = reliability(*(v.reshape(*v.shape[:2], -1) for v in (mean, a, b)))
        good = gain >= _MIN_RELIABILITY
        going = going[good]
        if not len(going):
            return changes, gains
    mean, a, b = (v[good] for v in (mean, a, b))
    changes[going] = mean * local_reliability(mean, a, b, knn)[..., None, None]
    gains[going] = gain[good]
    return changes, gains
