"""The linear fit of the motion: all components and parts of the cameras, a few at once, in two turns.

The first turn explains the component images. What the found motion shows beyond the derivative, and the light that goes
with it (`beyond.py`), is then taken from what is left, and edges of the prior that two halves of the cameras find
strained are loosened (`prior/edge_reweighting.py`), both only if the motion is small. The second turn solves for the
difference that this makes. Together they take the iterations of one fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.prior.edge_reweighting import edge_residual, reweight_edges
from tg4mm.motion.prior.graph import Graph
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.pcg import CGState, on_cpu, placed, start, step_all
from tg4mm.motion.solver.problem import MotionProblem

# components that share a pass over the views: half the time of eight passes, memory for eight fields
TOGETHER = 8
_SECOND = 0.7  # of the iterations
_ARRAYS = ("shapes", "left", "initial", "fields", "strain")  # of a `Fit`


@dataclass
class Fit:
    """Where the fit stands: `shapes` [P R, N, DOF], the first `component` of them found, and what is being solved.

    Where the cameras are halved (P = 2), those of the first half come first. `left` [P R, parameters, 3] is b − A x of
    the first turn; from the second on, the right-hand sides of what that one solves for. `initial` [P R]: |b|² of the
    first, by which both turns measure what is left. `fields` [P R, 4N, 3]: x of the first turn, where edges may
    be loosened after it, then `strain` [E], by what they are; empty where nobody asks for them.
    """

    shapes: np.ndarray
    left: np.ndarray
    initial: np.ndarray
    turn: int = 0
    component: int = 0
    is_small: bool = True  # is the motion? told after the first turn
    # components that had light between the turns, the others will have none; None: not looked for
    lit: list[int] | None = None
    fields: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    strain: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    # of the components from `component` on; empty: not begun
    cgs: list[CGState] = field(default_factory=list)

    @staticmethod
    def begun(n_fields: int, n_gaussians: int) -> Fit:
        fields, nothing = np.zeros((n_fields, n_gaussians, DOF), np.float32), np.zeros((0, 0, 3), np.float32)
        return Fit(fields, nothing, np.zeros(n_fields))

    def tensors(self) -> dict[str, Tensor]:
        out = {name: torch.from_numpy(getattr(self, name)) for name in _ARRAYS}
        for name in ("x", "residual", "direction") if self.cgs else ():
            out[name] = torch.from_numpy(np.stack([on_cpu(getattr(cg, name)) for cg in self.cgs]))
        return out

    def state(self) -> dict[str, Any]:
        cgs = [{"initial": cg.initial, "iteration": cg.iteration} for cg in self.cgs]
        where = {"turn": self.turn, "component": self.component, "is_small": self.is_small, "lit": self.lit}
        return where | {"cgs": cgs}

    @staticmethod
    def restored(checkpoint: tuple[dict[str, Tensor], dict[str, Any]], device: str = "cpu") -> Fit:
        """From what `tensors` and `state` gave."""
        tensors, state = checkpoint
        a = {k: v.numpy() for k, v in tensors.items()}
        cgs = [
            placed(CGState(a["x"][k], a["residual"][k], a["direction"][k], **numbers), device)
            for k, numbers in enumerate(state["cgs"])
        ]
        where = state["turn"], state["component"], state["is_small"], state["lit"]
        return Fit(a["shapes"], a["left"], a["initial"], *where, a["fields"], a["strain"], cgs)


@dataclass(frozen=True)
class Solver:
    """Solves for all components of all parts of the cameras."""

    problems: Sequence[MotionProblem | DeviceProblem]  # one for each part
    parts: Sequence[np.ndarray]  # cameras
    images: np.ndarray  # [V, …, H, W, 3] component images
    signal: np.ndarray  # [R] which of them
    config: MotionConfig
    device: str
    begun: CGState | None = None  # of the first part component 0, as far as it has been solved for already
    graph: Graph | None = None  # of the prior, whose edges are loosened between the turns; None: they are not

    @property
    def n_fields(self) -> int:
        return len(self.parts) * len(self.signal)

    def iterations(self, turn: int) -> int:
        second = int(_SECOND * self.config.iterations)
        return second if turn else self.config.iterations - second

    @property
    def units(self) -> int:
        """Of progress: one iteration of one component."""
        return self.n_fields * self.config.iterations

    def done(self, fit: Fit) -> int:
        before, most = fit.turn * self.n_fields * self.iterations(0), self.iterations(fit.turn)
        own = sum(cg.iteration if self._is_open(cg, most) else most for cg in fit.cgs)
        return before + fit.component * most + own

    def run(self, fit: Fit, update: Callable[..., None], keep: Callable[[Fit], None]) -> None:
        """The rest of a turn. `keep` is called after every iteration."""
        while fit.component < self.n_fields:
            self._solve(fit, update, keep)
        update(self.done(fit))

    def take_away(self, fit: Fit, part: int, pictures: Callable[[slice], Iterable[np.ndarray]]) -> None:
        """From what is left to one part of the cameras: for some of the R components [r, H, W, 3] of each view."""
        count = len(self.signal)
        for first in range(0, count, TOGETHER):
            some = slice(first, min(first + TOGETHER, count))
            for k, b in enumerate(self.problems[part].right_hand_sides(pictures(some)), part * count + first):
                fit.left[k] -= on_cpu(b)

    def strained(self, fit: Fit) -> np.ndarray:
        """[E]: what the first turn's fields of two halves agree on; none if edges are not loosened."""
        if self.graph is None:
            return np.zeros(0, np.float32)
        return edge_residual(self.graph, *np.split(fit.fields, 2))

    def loosened(self, of_edges: np.ndarray) -> Solver:
        """With edges loosened by their strain [E]."""
        assert self.graph is not None
        first: Any = self.problems[0].with_graph(reweight_edges(self.graph, of_edges))
        return replace(self, problems=[first, *(p.with_prior_of(first) for p in self.problems[1:])])

    def take_over(self, fit: Fit, before: Solver) -> None:
        """What is left, from the prior `before` the edges were loosened to that of now."""
        for k, x in enumerate(fit.fields):
            part = k // len(self.signal)
            fit.left[k] += on_cpu(before.problems[part].prior(x) - self.problems[part].prior(x))

    def _is_open(self, cg: CGState, most: int) -> bool:
        return cg.iteration < most and cg.relative_residual > self.config.tolerance

    def _begun(self, fit: Fit) -> list[CGState]:
        """The components that are solved for together, from where the fit stands."""
        part, first = divmod(fit.component, len(self.signal))
        some = self.signal[first : first + (TOGETHER if self.device == "cpu" else 1)]
        if fit.turn:
            rows = range(fit.component, fit.component + len(some))
            states = [replace(start(fit.left[k]), initial=float(fit.initial[k])) for k in rows]
            return [placed(state, self.device) for state in states]
        pictures = (self.images[v, some] for v in self.parts[part])
        states = [start(b) for b in self.problems[part].right_hand_sides(pictures)]
        known = None if part or self.signal[first] else self.begun
        if known is not None and known.iteration <= self.iterations(0):
            states[0] = known
        return states

    def _solve(self, fit: Fit, update: Callable[..., None], keep: Callable[[Fit], None]) -> None:
        """A few components at once, each from where its state stands until its own end."""
        problem, most = self.problems[fit.component // len(self.signal)], self.iterations(fit.turn)
        fit.cgs = fit.cgs or self._begun(fit)
        while going := [k for k, cg in enumerate(fit.cgs) if self._is_open(cg, most)]:
            stepped = step_all([fit.cgs[k] for k in going], problem.normals)
            fit.cgs = [stepped[going.index(k)] if k in going else cg for k, cg in enumerate(fit.cgs)]
            worst = max(cg.relative_residual for cg in fit.cgs)
            update(self.done(fit), components=f"{len(going)} at once", residual=round(worst, 4))
            keep(fit)
        for k, cg in enumerate(fit.cgs, fit.component):
            fit.shapes[k] += on_cpu(problem.field(cg.x))
            if not fit.turn:
                self._leave(fit, k, cg)
        fit.component, fit.cgs = fit.component + len(fit.cgs), []

    def _leave(self, fit: Fit, k: int, cg: CGState) -> None:
        residual = on_cpu(cg.residual)
        if not len(fit.left):
            fit.left = np.zeros((self.n_fields, *residual.shape), np.float32)
        fit.left[k], fit.initial[k] = residual, cg.initial
        if self.graph is None:
            return
        x = on_cpu(self.problems[k // len(self.signal)].rows(cg.x))
        if not len(fit.fields):
            fit.fields = np.zeros((self.n_fields, *x.shape), np.float32)
        fit.fields[k] = x
