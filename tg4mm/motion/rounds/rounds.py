"""Motion of more than a pixel: fit, move, look what is left, fit again.

A picture answers to motion in proportion as long as it is less than about a pixel, and the scene at rest was fitted to
a mean over time that larger motion blurs. So where the linear fit moves things by more than half a pixel it is repeated
(Gauss-Newton): every round renders what the motion found so far shows, fits the motion to what is left with Jacobians
where things have moved to (`linearised.py`), and then the scene at rest to all pictures (`polish.py`). A round counts
only if the new motion leaves less of the pictures than the old one; if not, half its step is tried, and if that does
not help either, that was all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from torch import Tensor

from tg4mm.capture import ImageStack
from tg4mm.capture.pictures import FilePictures
from tg4mm.gaussians import Gaussians
from tg4mm.motion.certainty.halves import LEAST, agreed_fields
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.linear import RestView, rest_view
from tg4mm.motion.pictures.differences import TemporalComponents
from tg4mm.motion.pictures.states import most_states, state_pictures, states_of
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.motion.posing.noise import pixel_weights
from tg4mm.motion.posing.pose import Findings, Problems
from tg4mm.motion.posing.weight import CANDIDATES, chosen_weight
from tg4mm.motion.rounds.linearised import Linearised, linearised, misfit, remaining
from tg4mm.motion.rounds.pixels import pixels_moved
from tg4mm.motion.rounds.polish import Polish, Seen
from tg4mm.motion.rounds.where import VERSION, Where, restored
from tg4mm.motion.solver.problem import MotionProblem
from tg4mm.motion.solver.solve import start, step

ABOVE_PX = 0.5  # motion up to so many pixels is in the linear range
_FALL = 0.05  # of the misfit: what falls by less is not worth another round
Keep = Callable[[Callable[[], dict[str, Tensor]], Callable[[], dict[str, Any]]], None]


def used_components(is_noise: np.ndarray) -> np.ndarray:
    """Which temporal components rounds fit: those of the linear fit, and of the others as many and one.

    Pictures saturate where things move far, so that the first component is not quite what the motion does in time; the
    rest of that is in weaker ones. What is noise there after all fades by what the halves agree on.
    """
    linear, others = np.flatnonzero(~is_noise), np.flatnonzero(is_noise)
    return np.sort(np.concatenate([linear, others[: len(linear) + 1]]))


class Rounds:
    """What all rounds share: pictures of every state, cameras and their parts, settings."""

    def __init__(
        self,
        images: ImageStack | FilePictures,
        cameras: list[FixedCamera],
        components: TemporalComponents,
        findings: Findings,
        parts: Sequence[np.ndarray],
        config: MotionConfig,
        device: str,
    ) -> None:
        self.cameras, self.parts, self.config, self.device = cameras, parts, config, device
        used = used_components(findings.is_noise)
        self.basis, self._linear = components.basis[used], np.flatnonzero(~findings.is_noise[used])
        self.weights = pixel_weights(components, ~np.isin(np.arange(len(components.basis)), used))
        self.images = images
        height, width = components.images.shape[2:4]
        self.size = (width, height)
        # as many as a quarter of the space stage's; few cameras alone would bend a scene that others saw, too
        enough = len(cameras) >= LEAST
        self.polishing = int(np.clip(40 * (width * height / 4) ** (1 / 3), 250, 7_500)) if enough else 0

    @property
    def units(self) -> int:
        """Of progress, for a round: iterations of polishing, and how many of them those of the fit take."""
        return len(self.parts) * self.config.iterations * self._costs + self.polishing

    @property
    def _costs(self) -> int:
        return max(2 * len(self.cameras) // len(self.parts), 1)

    def begun(
        self,
        gaussians: Gaussians,
        views: list[RestView],
        fields: np.ndarray,
        neighbours: float,
        checkpoint: tuple[dict[str, Tensor], dict[str, Any]] | None,
    ) -> tuple[Where, float]:
        """Where to go on, and how far (pixels) things move at the state that moves most, as far as is known then.

        fields [P, R, N, DOF] and views: of the linear fit. A checkpoint of another version is not looked at.
        """
        if checkpoint is not None and checkpoint[1].get("version") == VERSION:
            where = restored(*checkpoint, self.basis, self.size, self.device)
            return where, self._moved(where, self._rest(where.gaussians))
        linear, fields = fields, np.zeros((len(fields), len(self.basis), *fields.shape[2:]), np.float32)
        fields[:, self._linear] = linear
        shapes, _ = agreed_fields(fields)
        pixels = self._pixels_of(views, gaussians.means.numpy(), shapes)
        states = states_of(self.basis, pixels, most_states(len(self.cameras), self.size))
        where = Where(gaussians, fields, neighbours, states)
        return where, self._moved(where, views)

    def _moved(self, where: Where, views: list[RestView]) -> float:
        shapes, _ = agreed_fields(where.fields)
        means = where.gaussians.means.numpy()
        moved = np.tensordot(where.states.gains, shapes[..., :3], 1).astype(np.float32)
        return max(pixels_moved(views, self.cameras, means, shift) for shift in moved)

    def run(self, where: Where, keep: Keep, update: Callable[..., None]) -> Where:
        """Go on to the end. `keep` is called with what to save after every iteration, `update` with those done."""
        self.states = where.states
        self.pictures = state_pictures(self.images, self.cameras, self.states)
        if not where.misfits:
            where.misfits = [self._misfit(where.gaussians, agreed_fields(where.fields)[0])]
        while where.round < self.config.rounds and not where.is_over:
            if where.polish is None:
                self._fit(where, keep, update)
            if where.polish is not None:
                self._polish(where, keep, update)
        return where

    def target(self, where: Where) -> np.ndarray:
        """[V, R, H, W, 3]: the component images that the motion found explains, linearised at rest."""
        shapes, _ = agreed_fields(where.fields)
        left = remaining(where.gaussians, self._seen(shapes), self.states, self.device)
        weighted = (self.states.gains * self.states.count[:, None]).astype(np.float32)
        target = np.einsum("vkhwc,kr->vrhwc", left, weighted)
        target += np.stack([view.push_all(shapes) for view in self._rest(where.gaussians)])
        return np.asarray(target, np.float32)

    def _fit(self, where: Where, keep: Keep, update: Callable[..., None]) -> None:
        """One round's motion: begins polishing if it is accepted, else it is over."""
        shapes, _ = agreed_fields(where.fields)
        left = remaining(where.gaussians, self._seen(shapes), self.states, self.device)
        problem = self._problem(where, shapes, left)
        while len(where.found) < len(self.parts):
            self._solve(where, problem, keep, update)
        new = np.stack(where.found)
        where.found, where.is_chosen = [], False
        before = misfit(left, self.states)
        for length in (1.0, 0.5):
            stepped = (where.fields + np.float32(length) * (new - where.fields)).astype(np.float32)
            if self._misfit(where.gaussians, agreed_fields(stepped)[0]) < before:
                where.fields = stepped
                where.polish = Polish.begun(
                    where.gaussians, self.polishing, self.size, self.config.seed + where.round, self.device
                )
                return
        where.is_over = True

    def _problem(self, where: Where, shapes: np.ndarray, left: np.ndarray) -> Linearised:
        views, g = self._rest(where.gaussians), where.gaussians
        problems = Problems(views, g, self.config, "cpu")
        if not where.is_chosen:
            where.neighbours = self._weight(problems, where, shapes, left)
            where.is_chosen = True
        (rest,) = problems.of(self.weights, [where.neighbours])
        assert isinstance(rest, MotionProblem)
        pixels = self._pixels_of(views, g.means.numpy(), shapes)
        return linearised(rest, g, self._seen(shapes), shapes, left, self.states, pixels, self.device)

    def _weight(self, problems: Problems, where: Where, shapes: np.ndarray, left: np.ndarray) -> float:
        """As before the fit, from the strongest component with what is left of it by now, linearised at rest."""
        if self.config.neighbours or len(self.parts) == 1:
            return where.neighbours
        weighted = (self.states.gains[:, 0] * self.states.count).astype(np.float32)
        target = np.einsum("vkhwc,k->vhwc", left, weighted)
        target += np.stack([view.push(shapes[0]) for view in problems.views])
        return chosen_weight(problems.of(self.weights, list(CANDIDATES)), self.parts, target)

    def _solve(self, where: Where, problem: Linearised, keep: Keep, update: Callable[..., None]) -> None:
        """One part of the cameras, from where it stands to its end."""
        rows = self.parts[len(where.found)]
        own = problem.problem.of_views(rows)
        cg = where.cg or start(own.right_hand_side([t[rows] for t in problem.targets]))
        while cg.iteration < self.config.iterations and cg.relative_residual > self.config.tolerance:
            cg = where.cg = step(cg, own.normal)
            done = (len(where.found) * self.config.iterations + cg.iteration) * self._costs
            self._tell(where, done, keep, update, residual=round(cg.relative_residual, 4))
            if cg.is_exact:
                break
        where.found.append(own.fields(cg.x))
        where.cg = None

    def _polish(self, where: Where, keep: Keep, update: Callable[..., None]) -> None:
        polish = where.polish
        assert polish is not None
        shapes, _ = agreed_fields(where.fields)
        seen = self._seen(shapes)
        while polish.done < polish.iterations:
            polish.step(seen)
            done = self.units - self.polishing + polish.done
            self._tell(where, done, keep, update)
        where.gaussians = polish.gaussians() if polish.iterations else where.gaussians
        where.polish = None
        where.misfits.append(self._misfit(where.gaussians, shapes))
        before, after = where.misfits[-2:]
        where.is_over = after > (1 - _FALL) * before

    def _tell(self, where: Where, done: int, keep: Keep, update: Callable[..., None], **figures: Any) -> None:
        update(where.round * self.units + done, round=where.round + 1, **figures)
        keep(where.tensors, where.state)

    def _misfit(self, gaussians: Gaussians, shapes: np.ndarray) -> float:
        return misfit(remaining(gaussians, self._seen(shapes), self.states, self.device), self.states)

    def _seen(self, shapes: np.ndarray) -> Seen:
        motions = np.tensordot(self.states.gains, shapes, 1).astype(np.float32)
        return Seen(self.cameras, self.pictures, motions)

    def _rest(self, gaussians: Gaussians) -> list[RestView]:
        return [rest_view(gaussians, camera, self.size) for camera in self.cameras]

    def _pixels_of(self, views: list[RestView], means: np.ndarray, shapes: np.ndarray) -> np.ndarray:
        """[R] pixels that each component moves things by for a gain of 1."""
        return np.array([pixels_moved(views, self.cameras, means, s[:, :3]) for s in shapes])
