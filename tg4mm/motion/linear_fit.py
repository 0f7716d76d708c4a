"""The linear fit: every fold's fields by conjugate gradients, in two passes with a deferred correction between.

The first pass explains the target images. Appearance that goes with the motion is then taken from the residual
(`appearance.py`), and edges of the prior that two folds find strained are reweighted, both only if the motion is small.
The second pass solves for the difference that this makes: A δ = b − A x − Jᵀ W (appearance). Together they take the
iterations of one fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tg4mm.motion.checkpoints import Arrays, Checkpoint
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.hyperparameters import CANDIDATES, Hyperparameters
from tg4mm.motion.prior.graph import Graph, edge_residual, reweight_edges
from tg4mm.motion.solver.operator import Fold, Operator
from tg4mm.motion.solver.pcg import fetched, pcg, sent
from tg4mm.motion.solver.problem import Problem
from tg4mm.motion.targets import TargetImages
from tg4mm.progress import progress

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
        """Of each fold: `fields` [R, N, 6], `x` [R, 4N, 3], `residual` [R, P, 3] and `norms` of the equations.

        `iterations`: of a fit that no second pass follows; None for the first's part of them.
        """
        first = self.config.iterations - self._of_second if iterations is None else iterations
        return [
            self.checkpoint(f"first_pass_{p}", partial(self._first, p, first)) for p in range(len(self.folds))
        ]

    def within(self, support: np.ndarray, k: int) -> list[Arrays]:
        """The k-th fit in which fields move nothing outside their support [R, N], as `first_pass`."""

        def checkpoint(name: str, compute: Callable[[], Arrays]) -> Arrays:
            return self.checkpoint(f"{name}_support_{k}", compute)

        own = replace(self, problem=replace(self.problem, support=support), checkpoint=checkpoint)
        return own.first_pass(self.config.iterations)

    def second_pass(
        self, first: Sequence[Arrays], is_small: bool, correction: Correction | None = None
    ) -> np.ndarray:
        """[P, R, N, 6]: the fields with what a second pass adds, edges reweighted where the motion `is_small`.

        `correction`: what is taken from the target images; None: nothing.
        """
        graph = self._reweighted(first) if is_small else None
        return np.stack(
            [
                self.checkpoint(f"second_pass_{p}", partial(self._second, p, first[p], correction, graph))[
                    "fields"
                ]
                for p in range(len(self.folds))
            ]
        )

    @property
    def _of_second(self) -> int:
        """Iterations."""
        return int(_SECOND * self.config.iterations)

    def _chunks(self) -> list[slice]:
        if self.problem.mixing is not None:
            return [slice(None)]
        n, step = len(self.hyper.signal), TOGETHER if self.problem.device == "cpu" else 1
        return [slice(a, min(a + step, n)) for a in range(0, n, step)]

    def _images(self, fold: Fold, some: slice) -> Iterator[np.ndarray]:
        rows = slice(None) if self.problem.mixing is not None else self.hyper.signal[some]
        return (self.targets.of(v, rows) for v in fold.views)

    def _first(self, p: int, iterations: int) -> Arrays:
        fold = self.folds[p]
        operator, out, chunks = self.operator(fold), [], self._chunks()
        with progress(f"motion, fold {p + 1}", len(chunks) * iterations, "iterations") as update:
            for k, some in enumerate(chunks):
                b = operator.right_hand_sides(self._images(fold, some))
                tell = _telling(update, k * iterations)
                solution = pcg(operator, b, iterations, self.config.tolerance, update=tell)
                theta = solution.theta
                own = operator.fields(theta), operator.gradient_fields(theta), fetched(solution.residual)
                out.append((*own, solution.norms))
        names = "fields", "x", "residual", "norms"
        return {
            name: np.concatenate(arrays) for name, arrays in zip(names, zip(*out, strict=True), strict=True)
        }

    def _second(self, p: int, first: Arrays, correction: Correction | None, graph: Graph | None) -> Arrays:
        fold, iterations = self.folds[p], self._of_second
        before, out, chunks = self.operator(fold), [], self._chunks()
        operator = before if graph is None else before.with_graph(graph)
        with progress(f"motion, fold {p + 1}, corrected", len(chunks) * iterations, "iterations") as update:
            for k, some in enumerate(chunks):
                b = first["residual"][some].copy()
                if correction is not None:
                    b -= fetched(operator.right_hand_sides(correction(p, first["fields"], some)))
                if graph is not None:
                    x = first["x"][some]
                    b += fetched(before.prior_products(x)) - fetched(operator.prior_products(x))
                norms = first["norms"] if before.is_coupled else first["norms"][some]
                tell = _telling(update, k * iterations)
                solution = pcg(
                    operator, sent(b, self.problem.device), iterations, self.config.tolerance, norms, tell
                )
                out.append(first["fields"][some] + operator.fields(solution.theta))
        return {"fields": np.concatenate(out)}

    def _reweighted(self, first: Sequence[Arrays]) -> Graph | None:
        """The graph with edges reweighted; None where only one fold, or the least weight, was chosen."""
        if len(first) < 2 or self.hyper.smoothness_weight <= CANDIDATES[0]:
            return None
        return reweight_edges(
            self.problem.graph, edge_residual(self.problem.graph, first[0]["x"], first[1]["x"])
        )


def _telling(update: Callable[..., None], before: int) -> Callable[[int, float], None]:
    return lambda done, residual: update(before + done, residual=round(residual, 4))
