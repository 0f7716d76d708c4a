"""The light of the temporal components: what motion leaves of their images, as changes of the Gaussians' colour.

Two halves of the cameras are fitted, as for the motion, and their mean is kept as far as they agree around each
Gaussian: light changes in places. A component on which they agree less than half altogether holds noise, or what is no
light, and is dropped, after one iteration if it shows by then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.carried.carried import Carried
from tg4mm.motion.certainty.halves import agreed_gain, mean_around
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.light.answers import HARMONIC, lit_views
from tg4mm.motion.light.problem import LightProblem
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.motion.prior.graph import Graph
from tg4mm.motion.solver.pcg import CGState, start, step_all

ITERATIONS = 3  # six do hardly better: docs/decisions.md
LOOK = 1  # iterations after which it is told whether the halves agree; enough between the motion's two turns
_AGREED = 0.5  # gain below which a component has no light
_TOGETHER = 8  # components that share a pass over the views


@dataclass(frozen=True)
class Remainder:
    """What motion leaves of component images: of `asked` [r] among R components."""

    views: Sequence[ViewJacobian]
    pictures: np.ndarray  # [V, …, H, W, 3]
    rows: np.ndarray  # [R] which of the components
    shapes: np.ndarray  # [R, N, DOF], their motion
    carried: Carried | None  # what that shows beyond the derivative
    asked: np.ndarray

    def of(self, part: np.ndarray, some: np.ndarray) -> Iterator[np.ndarray]:
        """[s, H, W, 3] of each of the views `part`, for `some` of the R components."""
        for v in part:
            left = self.pictures[v, self.rows[some]] - self.views[v].jvp(self.shapes[some])
            yield left if self.carried is None else left - self.carried.of(v, self.shapes)[some]


@dataclass(frozen=True)
class Lighting:
    """The search for light with two halves of the cameras."""

    problem: LightProblem
    parts: Sequence[np.ndarray]
    around: np.ndarray  # [N, count], the Gaussians around each

    @staticmethod
    def of(
        views: Sequence[ViewJacobian],
        cameras: Sequence[FixedCamera],
        gaussians: Gaussians,
        weights: np.ndarray | None,
        graph: Graph,
        parts: Sequence[np.ndarray],
    ) -> Lighting:
        """weights [V, H, W]: of pixels; graph: of neighbours; parts: two halves of the cameras."""
        lit = lit_views(views, cameras, gaussians.means.numpy(), gaussians.sh_degree > 0)
        return Lighting(LightProblem.of(lit, weights, graph), parts, graph.knn)

    def fitted(
        self,
        remainder: Remainder,
        update: Callable[[int], None] | None = None,
        iterations: int = ITERATIONS,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the first coefficients of spherical harmonics [R, N, K, 3] float32, and gains [R].

        A component that is dropped, or was not asked for, has gain and change 0. `update` is called with how many are
        done.
        """
        halves = [self.problem.of_views(part) for part in self.parts]
        found = np.zeros((len(remainder.rows), *self.problem.root.shape[:2], 3), np.float32)
        gains = np.zeros(len(found), np.float32)
        for first in range(0, len(remainder.asked), _TOGETHER):
            some = remainder.asked[first : first + _TOGETHER]
            sides = [
                half.right_hand_sides(remainder.of(part, some))
                for half, part in zip(halves, self.parts, strict=True)
            ]
            x, gains[some] = agreed_light(halves, sides, self.around, iterations)
            found[some] = x / np.float32(HARMONIC)
            if update is not None:
                update(first + len(some))
        return found, gains

    def shown(self, v: int, changes: np.ndarray) -> np.ndarray:
        """[R, H, W, 3]: the pictures in view `v` of changes [R, N, K, 3]; until the next call."""
        return self.problem.views[v].show(changes * np.float32(HARMONIC), self.problem.buffers)


def agreed_light(
    halves: Sequence[LightProblem],
    sides: Sequence[Sequence[np.ndarray]],
    around: np.ndarray,
    iterations: int = ITERATIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of colour [R, N, K, 3] and gains [R] from the problems of two halves and R right-hand sides of each.

    around [N, count]: the Gaussians around each.
    """
    states = [[start(b) for b in some] for some in sides]
    found = np.zeros((len(states[0]), *states[0][0].x.shape), np.float32)
    gains, going = np.zeros(len(found), np.float32), np.arange(len(found))
    for last in sorted({LOOK, iterations}):
        states = [_stepped(half, some, last) for half, some in zip(halves, states, strict=True)]
        a, b = (
            np.stack([half.colours(s.x) for s in some]) for half, some in zip(halves, states, strict=True)
        )
        whole = (a + b) / 2
        gain = agreed_gain(*(v.reshape(*v.shape[:2], -1) for v in (whole, a, b)))
        good = np.flatnonzero(gain >= _AGREED)
        going, states = going[good], [[some[k] for k in good] for some in states]
        if not len(going):
            return found, gains
    whole, a, b = (v[good] for v in (whole, a, b))
    found[going] = whole * _gain_around(whole, a, b, around)[..., None, None]
    gains[going] = gain[good]
    return found, gains


def _gain_around(whole: np.ndarray, a: np.ndarray, b: np.ndarray, around: np.ndarray) -> np.ndarray:
    """[R, N] float32, 0 to 1: `agreed_gain` of the Gaussians around each, of components [R, N, K, 3]."""
    both, power = (np.einsum("rnkc,rnkc->nr", *pair) for pair in ((a, b), (whole, whole)))
    both, power = np.split(mean_around(np.concatenate([both, power], 1), around).T, 2)
    return np.clip(both / np.maximum(power, np.finfo(np.float32).tiny), 0, 1)


def _stepped(problem: LightProblem, states: list[CGState], last: int) -> list[CGState]:
    """The states after iteration `last`."""
    while any(s.iteration < last and not s.is_exact for s in states):
        states = step_all(states, problem.normals)
    return states
