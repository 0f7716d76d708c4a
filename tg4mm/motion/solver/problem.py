"""The motion problem of one scene and its views, from which operators for folds and weights are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.nuisance.projection import Nuisance, Projection, without
from tg4mm.motion.prior.graph import Graph, build_graph
from tg4mm.motion.solver.aggregates import Aggregates, aggregate
from tg4mm.motion.solver.cpu import CpuOperator
from tg4mm.motion.solver.cuda import DeviceOperator, DeviceViews
from tg4mm.motion.solver.operator import Fold
from tg4mm.motion.solver.preconditioner import PROBES, DiagonalEstimate, probe, two_level_preconditioner
from tg4mm.rasterize.reference import rotation_matrices


@dataclass(frozen=True)
class Problem:
    """Views, prior and coarse level; `operator` adds pixel weights and a smoothness weight."""

    views: Sequence[ViewJacobian]
    gaussians: Gaussians
    graph: Graph
    aggregates: Aggregates
    config: MotionConfig
    device: str = "cpu"
    nuisances: Sequence[Nuisance] = ()  # one a view; none: nothing is projected out
    means: np.ndarray | None = None  # [V, H, W, 3] mean pictures, for the nuisances
    mixing: Sequence[np.ndarray] | None = None  # C_v [ρ, R]
    projections: Sequence[Projection] | None = (
        None  # of views whose weights are final; None: made for each fold
    )
    support: np.ndarray | None = None  # [R, N] float32: which Gaussians a field may move, 1 or 0; None: all
    _kept: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)

    @staticmethod
    def of(views: Sequence[ViewJacobian], gaussians: Gaussians, config: MotionConfig, device: str) -> Problem:
        """With the graph of the Gaussians' neighbours."""
        means = gaussians.means.numpy()
        axes = rotation_matrices(gaussians.quats).numpy()
        graph = build_graph(means, axes, gaussians.scales.numpy())
        return Problem(views, gaussians, graph, aggregate(graph, means), config, device)

    @property
    def n_gaussians(self) -> int:
        return len(self.gaussians)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self.views[0].transmittance.shape
        return width, height

    def shown(self, v: int, fields: np.ndarray) -> np.ndarray:
        """[ρ, H, W, 3]: what view v's target images show of fields [R, N, 6]."""
        own = fields if self.mixing is None else np.tensordot(self.mixing[v], fields, 1)
        return self.views[v].jvp(np.ascontiguousarray(own))

    def without_nuisance(self, v: int, pictures: np.ndarray) -> np.ndarray:
        """Pictures [R, H, W, 3] of view v with its nuisance columns projected out."""
        if self.projections is not None:
            return self.projections[v].out_of(pictures)
        if not self.nuisances or self.means is None:
            return pictures
        return without(self.nuisances[v], self.means[v], pictures)

    @property
    def everything(self) -> Fold:
        return Fold(np.arange(len(self.views)))

    def operator(
        self, fold: Fold, weights: np.ndarray | None, smoothness_weight: float, probes: int = PROBES
    ) -> CpuOperator | DeviceOperator:
        """The problem that a fold poses, with pixel weights [V, H, W] or None; the prior is weaker in proportion."""
        operator = self.on_cpu(fold, weights, smoothness_weight, probes)
        if self.device == "cpu":
            return operator
        if "there" not in self._kept:
            self._kept["there"] = DeviceViews(self.views, self.graph, self.device)
        return DeviceOperator(operator, self._kept["there"])

    def on_cpu(
        self, fold: Fold, weights: np.ndarray | None, smoothness_weight: float, probes: int = PROBES
    ) -> CpuOperator:
        """`operator` on the CPU."""
        estimate = self._estimate(weights, probes)
        key = "preconditioner", id(weights), probes, smoothness_weight
        if key not in self._kept:
            prior, ridge = estimate.scale * smoothness_weight, estimate.scale * self.config.ridge
            self._kept[key] = two_level_preconditioner(self.aggregates, estimate, prior, ridge), weights
        share = len(fold.views) / len(self.views)
        if fold.pixels is not None:
            share *= float(fold.pixels.mean())
        return CpuOperator(
            [self.views[v] for v in fold.views],
            self.graph,
            self._kept[key][0],
            estimate.scale * share,
            smoothness_weight,
            self.config.ridge,
            fold.weighted(weights),
            self._projections(fold, weights),
            None if self.mixing is None else [self.mixing[v] for v in fold.views],
            self.support,
        )

    def _estimate(self, weights: np.ndarray | None, probes: int) -> DiagonalEstimate:
        key = "estimate", id(weights), probes
        if key not in self._kept:
            rng = np.random.default_rng(self.config.seed)
            probe_vectors = probe(list(self.views), self.n_gaussians, rng, self._shares(weights), probes)
            self._kept[key] = (
                DiagonalEstimate.of(self.aggregates, probe_vectors),
                weights,
            )  # held: its id would be used again
        return self._kept[key][0]

    def _shares(self, weights: np.ndarray | None) -> np.ndarray | None:
        """Weights times how much of a field each view sees on average, tr C_vᵀ C_v / R."""
        if self.mixing is None:
            return weights
        shares = np.array([(m**2).sum() / m.shape[1] for m in self.mixing], np.float32)[:, None, None]
        return shares if weights is None else shares * weights

    def _projections(self, fold: Fold, weights: np.ndarray | None) -> list[Projection] | None:
        if self.projections is not None:
            return [self.projections[v] for v in fold.views]
        if not self.nuisances or not self.nuisances[0].active.any():
            return None
        assert self.means is not None
        key = "projections", id(weights), fold.views.tobytes(), id(fold.pixels)
        if key not in self._kept:
            own = fold.weighted(weights)
            projections = [
                Projection.of(self.nuisances[v], self.means[v], None if own is None else own[k])
                for k, v in enumerate(fold.views)
            ]
            self._kept[key] = projections, weights, fold
        return self._kept[key][0]
