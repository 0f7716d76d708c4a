"""Whether the pictures change by as much as the fitted motion says: a test that does not trust the scene's geometry.

A fit by least squares comes out too small where the Jacobian is wrong: with few cameras Gaussians lie at wrong depths
or hang before what moves, and what they would change the pictures by is not what changed. Its own residual cannot tell.
The pictures can: what the slope ∇I of the scene's own picture and the flow f of the fitted motion m make of it,
P = −∇I · f, holds nothing of the Jacobian. With data y the ratio ⟨P, y⟩ / ⟨P, J m⟩ is one where m is right, whatever J
leaves out, and larger where m is too small (P is the instrument of an errors-in-variables problem: Fuller, Measurement
Error Models, 1987, §1.4).
"""

from dataclasses import dataclass

import numpy as np

from tg4mm.fit.motion.jacobian.pixels import optical_flow
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.rasterize.buffers import Buffers

LACKING = 1.5  # a ratio from which it is said: what is missing is half of what was found
_AT_ONCE = 4  # fields whose flow is in memory together


@dataclass
class PictureGain:
    """Sums over the views that were `add`ed."""

    along: float = 0.0  # ⟨P, J m⟩
    seen: float = 0.0  # ⟨P, y⟩

    def add(self, problem: Problem, v: int, fields: np.ndarray, targets: np.ndarray) -> None:
        """View v, and the fields [R, N, 6] that were fitted to its targets [ρ, H, W, 3]."""
        view, buffers = problem.views[v], Buffers()
        # not the filmed picture's: texture that the scene lacks is in the targets, but in no J m
        down, right = np.gradient(view.over_white, axis=(0, 1))
        own = fields if problem.mixing is None else np.tensordot(problem.mixing[v], fields, 1)
        for first in range(0, len(own), _AT_ONCE):
            some = np.ascontiguousarray(own[first : first + _AT_ONCE], np.float32)
            flow = optical_flow(view, some, buffers)
            carried = problem.without_nuisance(v, -(right * flow[..., :1] + down * flow[..., 1:2]))
            self.along += float(np.vdot(carried, view.jvp(some)))
            self.seen += float(np.vdot(carried, targets[first : first + _AT_ONCE]))

    @property
    def ratio(self) -> float:
        """By how much the motion should be larger; 1 where no view says so."""
        return self.seen / self.along if self.along > 0 else 1.0

    def squares(self, fields: np.ndarray) -> np.ndarray:
        """[N] squares of what fields [R, N, 6] lack of the displacement; from `LACKING` on they are a lower bound."""
        lacking = min(abs(self.ratio - 1), LACKING - 1)
        return lacking**2 * np.einsum("rnc,rnc->n", *2 * [fields[..., :3].astype(np.float64)])
