"""What pictures show of a motion beyond the derivative: errors that move along, the curve of pictures, and light."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.carried.carried import Carried
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.light.fit import ITERATIONS, Lighting, Remainder
from tg4mm.motion.pictures.differences import TemporalComponents
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.motion.posing.noise import pixel_weights
from tg4mm.motion.posing.pose import Findings
from tg4mm.motion.prior.graph import Graph


@dataclass(frozen=True)
class Beyond:
    """Of the components that are no noise."""

    views: Sequence[ViewJacobian]
    cameras: Sequence[FixedCamera]
    components: TemporalComponents
    findings: Findings
    signal: np.ndarray  # [R] which of the components
    gaussians: Gaussians
    graph: Graph
    parts: Sequence[np.ndarray]  # of the cameras
    asks_for_light: bool

    @cached_property
    def carried(self) -> Carried:
        return Carried(self.views, self.components.mean, self.components.basis[self.signal])

    @cached_property
    def lighting(self) -> Lighting | None:
        """None where light was not asked for, and where cameras are too few to tell it from noise."""
        if not self.asks_for_light or len(self.parts) == 1:
            return None
        weights = pixel_weights(self.components, self.findings.is_noise)
        return Lighting.of(self.views, self.cameras, self.gaussians, weights, self.graph, self.parts)

    def light(
        self,
        shapes: np.ndarray,
        is_small: bool,
        asked: np.ndarray,
        update: Callable[[int], None] | None = None,
        iterations: int = ITERATIONS,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Of fields [R, N, DOF], for the components `asked` [r]: `Lighting.fitted`, or None."""
        if self.lighting is None:
            return None
        carried = self.carried if is_small else None
        left = Remainder(self.views, self.components.images, self.signal, shapes, carried, asked)
        return self.lighting.fitted(left, update, iterations)

    def pictures(
        self, part: int, shapes: np.ndarray, changes: np.ndarray | None, some: slice
    ) -> Iterator[np.ndarray]:
        """For each view of a part of the cameras, [r, H, W, 3] for `some` of the R components.

        Of fields [R, N, DOF] and changes of colour [R, N, K, 3].
        """
        for v in self.parts[part]:
            out = self.carried.of(int(v), shapes)[some]
            if self.lighting is not None and changes is not None and changes[some].any():
                out = out + self.lighting.shown(int(v), changes[some])
            yield out
