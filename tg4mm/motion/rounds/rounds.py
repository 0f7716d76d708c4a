"""Motion of more than a pixel: fit, move, look what is left, fit again.

A picture answers to motion in proportion as long as it is less than about a pixel, and the scene at rest was fitted to
a mean over time that larger motion blurs. So where the linear fit moves things by more than 0.7 pixels it is repeated
(Gauss-Newton): every round renders what the motion found so far shows, fits the motion to what is left with Jacobians
where things have moved to (`linearised.py`), and then the scene at rest to all pictures (`polish.py`). A round counts
only if the new motion leaves less of the pictures than the old one; if not, half its step is tried, and if that does
not help either, that was all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from torch import Tensor

from tg4mm.capture import ImageStack
from tg4mm.capture.pictures import FilePictures
from tg4mm.gaussians import Gaussians
from tg4mm.motion.certainty.found import Found
from tg4mm.motion.certainty.halves import LEAST, agreed_fields
from tg4mm.motion.config import MotionConfig, more_iterations
from tg4mm.motion.jacobian.pixels import pixels_moved
from tg4mm.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.motion.pictures.differences import TemporalComponents
from tg4mm.motion.pictures.states import States, most_states, states_of
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.motion.posing.noise import pixel_weights
from tg4mm.motion.posing.pose import Findings, Problems
from tg4mm.motion.posing.weight import CANDIDATES, chosen_weight
from tg4mm.motion.prior.graph import nearest
from tg4mm.motion.rounds.evidence import Evidence
from tg4mm.motion.rounds.linearised import Linearised, linearised
from tg4mm.motion.rounds.polish import Polish
from tg4mm.motion.rounds.where import Checkpoint, Where, restored
from tg4mm.motion.solver.pcg import start, step
from tg4mm.motion.solver.problem import MotionProblem

ABOVE_PX = 0.7  # motion up to so many pixels is in the linear range: docs/decisions.md
# Iterations of the weight's choice, of up to 16,000 Gaussians. More than before the linear fit: what is left after a
# round tells less of it.
_OF_CHOICE = 6
_COMPONENTS = 8  # that are fitted, at least, where there are as many
_FALL = 0.05  # of the misfit: what falls by less is not worth another round
Keep = Callable[[Callable[[], dict[str, Tensor]], Callable[[], dict[str, Any]]], None]


def used_components(is_noise: np.ndarray) -> np.ndarray:
    """Which temporal components rounds fit: those of the linear fit, and as many others and one, or eight in all.

    Pictures saturate where things move far, so that the first component is not quite what the motion does in time; the
    rest of that is in weaker ones. What is noise there after all fades by what the halves agree on; but what moves and
    is left out counts as noise of its pixels, which then say less.
    """
    linear, others = np.flatnonzero(~is_noise), np.flatnonzero(is_noise)
    return np.sort(np.concatenate([linear, others[: max(len(linear) + 1, _COMPONENTS - len(linear))]]))


class Rounds:
    """What all rounds share: cameras and their parts, component images, settings."""

    def __init__(
        self,
        images: ImageStack | FilePictures,
        cameras: list[FixedCamera],
        components: TemporalComponents,
        findings: Findings,
        parts: Sequence[np.ndarray],
        config: MotionConfig,
        device: str,
        are_all: bool,
    ) -> None:
        """`are_all`: no camera but these made the scene at rest, which they may then sharpen."""
        self.cameras, self.parts, self.config, self.device = cameras, parts, config, device
        self._used = used_components(findings.is_noise)
        self.basis = components.basis[self._used]
        self._linear = np.flatnonzero(~findings.is_noise[self._used])
        self.weights = pixel_weights(components, ~np.isin(np.arange(len(components.basis)), self._used))
        self.images, self.components = images, components
        # all components together, linearised at several places: they settle more slowly
        self.iterations = config.iterations * 3 // 2
        height, width = components.images.shape[2:4]
        self.size = (width, height)
        # as many as a quarter of the space stage's; few cameras alone would bend a scene that others saw, too
        enough = len(cameras) >= LEAST and are_all
        self.polishing = int(np.clip(40 * (width * height / 4) ** (1 / 3), 250, 7_500)) if enough else 0

    @property
    def units(self) -> int:
        """Of progress, for a round: iterations of polishing, and how many of them those of the fit take."""
        return len(self.parts) * self.iterations * self._costs + self.polishing

    @property
    def _costs(self) -> int:
        return max(2 * len(self.cameras) // len(self.parts), 1)

    def begun(
        self,
        gaussians: Gaussians,
        views: list[ViewJacobian],
        fields: np.ndarray,
        neighbours: float,
        checkpoint: Checkpoint | None,
    ) -> Where:
        """Where to go on: from a checkpoint, else from the linear fit's fields [P, R, N, DOF] and views."""
        if checkpoint is not None:
            return restored(*checkpoint, self.basis, self.size, self.device)
        linear, fields = fields, np.zeros((len(fields), len(self.basis), *fields.shape[2:]), np.float32)
        fields[:, self._linear] = linear
        shapes, _ = agreed_fields(fields)
        states = states_of(
            self.basis, pixels_moved(views, shapes[..., :3]), most_states(len(self.cameras), self.size)
        )
        shifts = np.tensordot(states.gains, shapes[..., :3], 1).astype(np.float32)
        pixels = float(pixels_moved(views, shifts).max())
        return Where(gaussians, fields, neighbours, states, pixels)

    def evidence(self, states: States) -> Evidence:
        """What all rounds compare with; reads the images."""
        return Evidence.of(self.images, self.cameras, states, self.components.images[:, self._used])

    def run(self, where: Where, evidence: Evidence, keep: Keep, update: Callable[..., None]) -> Where:
        """Go on to the end. `keep` is called with what to save after every iteration, `update` with those done."""
        if not where.misfits:
            shapes, _ = agreed_fields(where.fields)
            where.misfits = [evidence.remaining(where.gaussians, shapes, self.device)[1].changes]
        while where.round < self.config.rounds and not where.is_over:
            if where.polish is None:
                self._fit(where, evidence, keep, update)
            if where.polish is not None:
                self._polish(where, evidence, keep, update)
        return where

    def outcome(self, where: Where, evidence: Evidence) -> Found:
        """What was found, explaining component images linearised at rest; these are made when they are asked for."""
        shapes, _ = agreed_fields(where.fields)
        views = self._rest(where.gaussians) if self.config.halves else []

        @cache
        def target() -> np.ndarray:
            return self._at_rest(views, where.gaussians, shapes, evidence)

        around = nearest(where.gaussians.means.numpy())[1]
        return Found(where.fields, shapes, where.gaussians, views, around, lambda v: target()[v])

    def _at_rest(
        self, views: list[ViewJacobian], gaussians: Gaussians, shapes: np.ndarray, evidence: Evidence
    ) -> np.ndarray:
        left, _ = evidence.remaining(gaussians, shapes, self.device)
        shown = np.stack([view.jvp(shapes) for view in views])
        return evidence.target(left, np.arange(len(evidence.states.gains)), shown)

    def _fit(self, where: Where, evidence: Evidence, keep: Keep, update: Callable[..., None]) -> None:
        """One round's motion: begins polishing if it is accepted, else it is over."""
        new = self._found(where, evidence, keep, update)
        for length in (1.0, 0.5):
            stepped = (where.fields + np.float32(length) * (new - where.fields)).astype(np.float32)
            errors = evidence.remaining(where.gaussians, agreed_fields(stepped)[0], self.device)[1]
            if errors.changes < where.misfits[-1]:
                where.fields, where.reached = stepped, errors
                seed = self.config.seed + where.round
                where.polish = Polish.begun(where.gaussians, self.polishing, self.size, seed, self.device)
                return
        where.is_over = True

    def _found(self, where: Where, evidence: Evidence, keep: Keep, update: Callable[..., None]) -> np.ndarray:
        """[P, R, N, DOF]: what each part of the cameras finds in this round."""
        problem = self._problem(where, evidence)
        while len(where.found) < len(self.parts):
            self._solve(where, problem, keep, update)
        new = np.stack(where.found)
        where.found, where.is_chosen = [], False
        return new

    def _problem(self, where: Where, evidence: Evidence) -> Linearised:
        views, g = self._rest(where.gaussians), where.gaussians
        shapes, _ = agreed_fields(where.fields)
        rest = self._posed(Problems(views, g, self.config, "cpu"), where, shapes, evidence)
        pixels = pixels_moved(views, shapes[..., :3])
        return linearised(rest, g, evidence, shapes, pixels, self.parts, self.device)

    def _posed(
        self, problems: Problems, where: Where, shapes: np.ndarray, evidence: Evidence
    ) -> MotionProblem:
        """The problem at rest. The weight of the neighbours is chosen anew for each round, as before the linear fit:
        from the strongest component with what is left of it by now."""
        is_given = where.is_chosen or self.config.neighbours or len(self.parts) == 1
        posed = problems.of(self.weights, [where.neighbours] if is_given else list(CANDIDATES))
        if not is_given:
            target = self._at_rest(problems.views, where.gaussians, shapes, evidence)[:, 0]
            iterations = round(_OF_CHOICE * more_iterations(len(where.gaussians)))
            where.neighbours, _ = chosen_weight(posed, self.parts, target, iterations)
        where.is_chosen = True
        (rest,) = (p for p in posed if p.config.neighbours == where.neighbours)
        assert isinstance(rest, MotionProblem)
        return rest

    def _solve(self, where: Where, problem: Linearised, keep: Keep, update: Callable[..., None]) -> None:
        """One part of the cameras, from where it stands to its end."""
        part = len(where.found)
        own = problem.problem.of_views(self.parts[part])
        cg = where.cg or start(problem.sides[part])
        while cg.iteration < self.iterations and cg.relative_residual > self.config.tolerance:
            cg = where.cg = step(cg, own.normal)
            done = (part * self.iterations + cg.iteration) * self._costs
            self._tell(where, done, keep, update, residual=round(cg.relative_residual, 4))
        where.found.append(own.fields(cg.x))
        where.cg = None

    def _polish(self, where: Where, evidence: Evidence, keep: Keep, update: Callable[..., None]) -> None:
        """The scene at rest for this round's motion; the one before stays where it shows the pictures better."""
        polish = where.polish
        assert polish is not None
        assert where.reached is not None
        shapes, _ = agreed_fields(where.fields)
        seen = evidence.seen(shapes)
        while polish.done < polish.iterations:
            polish.step(seen)
            done = self.units - self.polishing + polish.done
            self._tell(where, done, keep, update)
        if polish.iterations:
            gaussians = polish.gaussians()
            errors = evidence.remaining(gaussians, shapes, self.device)[1]
            if errors.within(where.reached):
                where.gaussians, where.reached = gaussians, errors
        where.misfits.append(where.reached.changes)
        where.polish, where.reached = None, None
        before, after = where.misfits[-2:]
        where.is_over = after > (1 - _FALL) * before

    def _tell(self, where: Where, done: int, keep: Keep, update: Callable[..., None], **figures: Any) -> None:
        update(where.round * self.units + done, round=where.round + 1, **figures)
        keep(where.tensors, where.state)

    def _rest(self, gaussians: Gaussians) -> list[ViewJacobian]:
        return [view_jacobian(gaussians, camera, self.size) for camera in self.cameras]
