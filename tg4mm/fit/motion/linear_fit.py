"""The linear fit: every fold's fields by conjugate gradients, in two passes with a deferred correction between.

The first pass explains the target images. Appearance that goes with the motion is then estimated from the residual
(`appearance.py`), and edges of the prior that two folds find strained are reweighted, both only if the motion is small.
The second pass solves for the resulting difference: A δ = b − A x − Jᵀ W (appearance). Together they take the
iterations of one fit.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tg4mm.core.progress import progress
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step, concatenated, suffixed
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.hyperparameters import LEAST, Hyperparameters
from tg4mm.fit.motion.prior import NeighbourGraph, edge_residual, reweight_edges
from tg4mm.fit.motion.solver.operator import Array, Fold, Operator
from tg4mm.fit.motion.solver.pcg import Solution, fetched, pcg, sent
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.targets import TargetImages

TOGETHER = 8  # components that share a pass over the views: half the time of eight passes
_SECOND = 0.5  # of the iterations
# of one fold p, given its fields [R, N, 6] of the first pass and some of the components: pictures of each of its views
Correction = Callable[[int, np.ndarray, slice], Iterable[np.ndarray]]


@dataclass(frozen=True)
class LinearFit:
    """Solves for all components of all folds."""

    problem: Problem
    targets: TargetImages
    hyper: Hyperparameters
    folds: Sequence[Fold]
    config: MotionConfig
    checkpoint: Checkpoint

    def operator(self, fold: Fold) -> Operator:
        """The problem that a fold poses."""
        return self.problem.operator(fold, self.hyper.smoothness_weight)

    def first_pass(self, iterations: int | None = None) -> list[Arrays]:
        """Each fold's `fields` [R, N, 6], `x` [R, 4N, 3], `residual` [R, P, 3] and `norms` of the equations.

        `iterations`: of a fit that no second pass follows; None for the first's part of them.
        """
        first = self.config.iterations - self._of_second if iterations is None else iterations
        return [
            self.checkpoint(Step.first_pass.numbered(p), partial(self._first, p, first))
            for p in range(len(self.folds))
        ]

    def within(self, support: np.ndarray, k: int) -> list[Arrays]:
        """The k-th fit in which fields move nothing outside their support [R, N], as `first_pass`."""
        checkpoint = suffixed(self.checkpoint, Step.support.numbered(k))
        limited = replace(self, problem=replace(self.problem, support=support), checkpoint=checkpoint)
        return limited.first_pass(self.config.iterations)

    def second_pass(
        self, first: Sequence[Arrays], is_small: bool, correction: Correction | None = None, rounds: int = 1
    ) -> np.ndarray:
        """Return [P, R, N, 6]: the fields with what a second pass adds, edges reweighted where the motion `is_small`.

        `correction`: what is taken from the target images; None: nothing. Each of the `rounds` corrects what the last
        one added.
        """
        graph, out = self._reweighted(first) if is_small else None, []
        for p in range(len(self.folds)):
            compute = partial(self._second, p, first[p], correction, rounds, graph)
            out.append(self.checkpoint(Step.second_pass.numbered(p), compute)["fields"])
        return np.stack(out)

    @property
    def _of_second(self) -> int:
        """Iterations."""
        return int(_SECOND * self.config.iterations)

    def _chunks(self) -> list[slice]:
        if self.problem.mixing is not None:
            return [slice(None)]
        n, step = len(self.hyper.signal), TOGETHER if self.problem.device == "cpu" else 1
        return [slice(a, min(a + step, n)) for a in range(0, n, step)]

    def _solutions(
        self,
        operator: Operator,
        label: str,
        iterations: int,
        sides: Callable[[slice], Array],
        norms: np.ndarray | None = None,
    ) -> Iterator[tuple[slice, Solution]]:
        """Solutions of some components after the other, from their right-hand `sides`; `norms` of all, as for `pcg`."""
        chunks = self._chunks()
        with progress(label, len(chunks) * iterations, "iterations") as update:
            for k, some in enumerate(chunks):

                def report(done: int, residual: float, k: int = k) -> None:
                    update(k * iterations + done, residual=round(residual, 4))

                bounds = norms if norms is None or operator.is_coupled else norms[some]
                yield some, pcg(operator, sides(some), iterations, self.config.tolerance, bounds, report)

    def _first(self, p: int, iterations: int) -> Arrays:
        fold = self.folds[p]
        operator, out = self.operator(fold), []

        def sides(some: slice) -> Array:
            rows = slice(None) if self.problem.mixing is not None else self.hyper.signal[some]
            return operator.right_hand_sides(self.targets.of(v, rows) for v in fold.views)

        for _, solution in self._solutions(operator, f"motion, fold {p + 1}", iterations, sides):
            fields, x = operator.fields(solution.theta), operator.gradient_fields(solution.theta)
            residual = fetched(solution.residual)
            out.append({"fields": fields, "x": x, "residual": residual, "norms": solution.norms})
        return concatenated(out)

    def _second(
        self, p: int, first: Arrays, correction: Correction | None, rounds: int, graph: NeighbourGraph | None
    ) -> Arrays:
        before = self.operator(self.folds[p])
        operator = before if graph is None else before.with_graph(graph)
        fields, step, left = first["fields"], first["fields"], first["residual"]
        for k in range(rounds):

            def sides(some: slice, k: int = k, step: np.ndarray = step, left: np.ndarray = left) -> Array:
                b = left[some].copy()
                if correction is not None:
                    b -= fetched(operator.right_hand_sides(correction(p, step, some)))
                if graph is not None and k == 0:
                    x = first["x"][some]
                    b += fetched(before.prior_products(x)) - fetched(operator.prior_products(x))
                return sent(b, self.problem.device)

            label = f"motion, fold {p + 1}, corrected"
            solved = self._solutions(operator, label, self._of_second, sides, first["norms"])
            each = [(operator.fields(s.theta), fetched(s.residual)) for _, s in solved]
            step, left = (np.concatenate(parts) for parts in zip(*each, strict=True))
            fields = fields + step
        return {"fields": fields}

    def _reweighted(self, first: Sequence[Arrays]) -> NeighbourGraph | None:
        """The graph with edges reweighted; None where there is one fold, or the smoothness weight is the least."""
        if len(first) < 2 or self.hyper.smoothness_weight <= LEAST:
            return None
        graph = self.problem.graph
        return reweight_edges(graph, edge_residual(graph, first[0]["x"], first[1]["x"]))
