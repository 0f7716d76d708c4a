"""The motion problem of one scene and its views, from which operators for folds are made."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tg4mm.fit.gaussians import Gaussians, rotation_matrices
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.view import ViewJacobian
from tg4mm.fit.motion.nuisance.projection import Nuisance, Projection, projections_of, without
from tg4mm.fit.motion.prior import NeighbourGraph, build_graph
from tg4mm.fit.motion.solver.cpu import CpuOperator
from tg4mm.fit.motion.solver.cuda import operator_on, views_on
from tg4mm.fit.motion.solver.operator import Fold, Operator
from tg4mm.fit.motion.solver.preconditioner import (
    PROBES,
    Aggregates,
    DiagonalEstimate,
    aggregate,
    multilevel_preconditioner,
    probe,
)


@dataclass(frozen=True)
class Problem:
    """Views, pixel weights, prior and coarse levels; `operator` adds a fold and a smoothness weight."""

    views: Sequence[ViewJacobian]
    gaussians: Gaussians
    graph: NeighbourGraph
    aggregates: Aggregates
    config: MotionConfig
    device: str = "cpu"
    pixel_weights: np.ndarray | None = None  # W [V, H, W] float32; None: 1
    nuisances: Sequence[Nuisance] = ()  # one a view; none: nothing is projected out
    means: np.ndarray | None = None  # [V, H, W, 3] mean pictures, for the nuisances
    mixing: Sequence[np.ndarray] | None = None  # C_v [ρ, R]
    projections: Sequence[Projection] | None = None  # one a view, whatever the fold; None: made for each
    support: np.ndarray | None = None  # [R, N] float32: which Gaussians a field may move, 1 or 0; None: all
    _kept: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)  # made once

    @staticmethod
    def of(
        views: Sequence[ViewJacobian], gaussians: Gaussians, config: MotionConfig, device: str
    ) -> "Problem":
        """Build the problem with the graph of the Gaussians' neighbours."""
        means = gaussians.means.numpy()
        axes = rotation_matrices(gaussians.quats).numpy()
        graph = build_graph(means, axes, gaussians.scales.numpy())
        return Problem(views, gaussians, graph, aggregate(graph, means), config, device)

    def changed(self, **fields: Any) -> "Problem":
        """Replace fields. Cached results are dropped, but for the views on a device."""
        kept = {k: v for k, v in self._kept.items() if k == "device_views" and "views" not in fields}
        return replace(self, **fields, _kept=kept)

    @property
    def n_gaussians(self) -> int:
        return len(self.gaussians)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self.views[0].transmittance.shape
        return width, height

    def shown(self, v: int, fields: np.ndarray) -> np.ndarray:
        """Return [ρ, H, W, 3]: what view v's target images show of fields [R, N, 6]."""
        mixed = fields if self.mixing is None else np.tensordot(self.mixing[v], fields, 1)
        return self.views[v].jvp(np.ascontiguousarray(mixed))

    def without_nuisance(self, v: int, pictures: np.ndarray) -> np.ndarray:
        """Pictures [R, H, W, 3] of view v with its nuisance columns projected out."""
        if self.projections is not None:
            return self.projections[v].out_of(pictures)
        if not self.nuisances or self.means is None:
            return pictures
        return without(self.nuisances[v], self.means[v], pictures)

    def residual(self, v: int, targets: np.ndarray, fields: np.ndarray) -> np.ndarray:
        """Return [ρ, H, W, 3]: target images of view v less what fields [R, N, 6] show, nuisance projected out."""
        return self.without_nuisance(v, targets - self.shown(v, fields))

    @property
    def everything(self) -> Fold:
        return Fold(np.arange(len(self.views)))

    def operator(self, fold: Fold, smoothness_weight: float, probes: int = PROBES) -> Operator:
        """The problem that a fold poses; the prior is weaker in proportion."""
        views = self._once("device_views", lambda: views_on(self.device, self.views, self.graph))
        return operator_on(views, self.on_cpu(fold, smoothness_weight, probes))

    def on_cpu(self, fold: Fold, smoothness_weight: float, probes: int = PROBES) -> CpuOperator:
        """`operator` on the CPU."""
        estimate = self._once(("estimate", probes), lambda: self._estimate(probes))
        prior, ridge = estimate.scale * smoothness_weight, estimate.scale * self.config.ridge
        preconditioner = self._once(
            ("preconditioner", probes, smoothness_weight),
            lambda: multilevel_preconditioner(self.aggregates, estimate, prior, ridge),
        )
        share = len(fold.views) / len(self.views)
        if fold.pixels is not None:
            share *= float(fold.pixels.mean())
        return CpuOperator(
            [self.views[v] for v in fold.views],
            self.graph,
            preconditioner,
            estimate.scale * share,
            smoothness_weight,
            self.config.ridge,
            fold.weighted(self.pixel_weights),
            self._once(("projections", fold), lambda: self._projections(fold)),
            None if self.mixing is None else [self.mixing[v] for v in fold.views],
            self.support,
        )

    def _once(self, key: Any, make: Callable[[], Any]) -> Any:
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    def _estimate(self, probes: int) -> DiagonalEstimate:
        """Pixels weighted by how much of a field each view sees on average, too: tr C_vᵀ C_v / R."""
        weights = self.pixel_weights
        if self.mixing is not None:
            shares = np.array([(m**2).sum() / m.shape[1] for m in self.mixing], np.float32)[:, None, None]
            weights = shares if weights is None else shares * weights
        rng = np.random.default_rng(self.config.seed)
        return DiagonalEstimate.of(self.aggregates, probe(self.views, self.n_gaussians, rng, weights, probes))

    def _projections(self, fold: Fold) -> list[Projection] | None:
        if self.projections is not None:
            return [self.projections[v] for v in fold.views]
        nuisances = [self.nuisances[v] for v in fold.views] if self.nuisances else []
        means = None if self.means is None else self.means[fold.views]
        return projections_of(nuisances, means, fold.weighted(self.pixel_weights))
