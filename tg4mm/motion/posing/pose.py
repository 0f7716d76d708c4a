"""The problem that a capture poses: what is noise, how much pixels count, how alike neighbours move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.config import MotionConfig, more_iterations
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.pictures.differences import TemporalComponents
from tg4mm.motion.posing.noise import LOOSE, noise_components, pixel_weights
from tg4mm.motion.posing.weight import CANDIDATES, DEFAULT, ITERATIONS, chosen_weight
from tg4mm.motion.prior.graph import build_graph
from tg4mm.motion.solver.aggregates import aggregate
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.pcg import CGState
from tg4mm.motion.solver.preconditioner import PROBES, DiagonalEstimate, probe, two_level_preconditioner
from tg4mm.motion.solver.problem import MotionProblem
from tg4mm.rasterize.reference import rotation_matrices


@dataclass(frozen=True)
class Findings:
    """What was found out from the images before the fit; with it a fit can be taken up again."""

    is_noise: np.ndarray  # [R] bool, temporal components
    neighbours: float

    def state(self) -> dict[str, Any]:
        return {"is_noise": [bool(v) for v in self.is_noise], "neighbours": self.neighbours}

    @staticmethod
    def of(state: dict[str, Any]) -> Findings:
        return Findings(np.array(state["is_noise"], bool), float(state["neighbours"]))


class Problems:
    """Problems of the same views that differ in weights, on the device where they are solved."""

    def __init__(
        self, views: list[ViewJacobian], gaussians: Gaussians, config: MotionConfig, device: str
    ) -> None:
        self.views, self.config, self.device = views, config, device
        self.means = gaussians.means.numpy()
        axes = rotation_matrices(gaussians.quats).numpy()
        self.graph = build_graph(self.means, axes, gaussians.scales.numpy())
        self.groups = aggregate(self.graph, self.means)
        self._there: DeviceProblem | None = None

    def of(
        self, weights: np.ndarray | None, neighbours: Sequence[float], probes: int = PROBES
    ) -> list[MotionProblem | DeviceProblem]:
        """One for each weight of the neighbours, all with the pixels' weights [V, H, W] or None."""
        rng = np.random.default_rng(self.config.seed)
        estimate = DiagonalEstimate.of(self.groups, probe(self.views, len(self.means), rng, weights, probes))
        scale, ridge = estimate.scale, estimate.scale * self.config.ridge
        return [
            self._placed(
                MotionProblem(
                    self.views,
                    self.graph,
                    two_level_preconditioner(self.groups, estimate, scale * value, ridge),
                    scale,
                    replace(self.config, neighbours=value),
                    weights,
                )
            )
            for value in neighbours
        ]

    def _placed(self, problem: MotionProblem) -> MotionProblem | DeviceProblem:
        if self.device == "cpu":
            return problem
        if self._there is None:
            self._there = on_device(problem, self.device)
        return self._there.posed_as(problem)


def on_device(problem: MotionProblem, device: str) -> Any:
    """The problem where it is solved: on the CPU itself, else a DeviceProblem."""
    return problem if device == "cpu" else DeviceProblem(problem, device)


def posed(
    problems: Problems,
    parts: Sequence[np.ndarray],
    components: TemporalComponents,
    at_once: int,
    known: Findings | None = None,
) -> tuple[Findings, MotionProblem | DeviceProblem, CGState | None]:
    """The problem of all cameras, and what was found on the way, or `known` from an earlier time.

    parts: two halves of the cameras; one part, all of them, where they are too few: then noise and weight are not
    looked for. Last, how far the strongest component's fit to the first part has come already; None
    where it has not begun, or would have ended.
    """
    asked = problems.config.neighbours or (DEFAULT if len(parts) == 1 else 0.0)
    if known is None:
        is_noise = np.zeros(len(components.basis), bool)
        if len(parts) == 2 and len(is_noise) > 1:
            (plain,) = problems.of(None, [LOOSE], PROBES // 2)  # for two iterations
            is_noise = noise_components(plain, parts, components.images, at_once)
    else:
        is_noise, asked = known.is_noise, known.neighbours
    candidates = problems.of(pixel_weights(components, is_noise), [asked] if asked else list(CANDIDATES))
    begun: CGState | None = None
    if not asked:
        iterations = round(ITERATIONS * more_iterations(len(problems.means)))
        asked, begun = chosen_weight(candidates, parts, components.images[:, 0], iterations)
    return Findings(is_noise, asked), next(p for p in candidates if p.config.neighbours == asked), begun
