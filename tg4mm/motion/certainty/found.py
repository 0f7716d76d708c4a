"""What was found in the end, and how sure it is where two halves of the cameras found it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.gaussians import Gaussians
from tg4mm.motion.certainty.alike import alike, displacement_left, variation
from tg4mm.motion.certainty.halves import deviation
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.pictures.video import FixedCamera

_VIEWS = 10  # in which it is told what is left


@dataclass(frozen=True)
class Found:
    """Fields of all cameras or of two halves, what these agree on, and what it explains."""

    fields: np.ndarray  # [P, R, N, DOF]
    shapes: np.ndarray  # [R, N, DOF], what they agree on
    gaussians: Gaussians
    views: list[ViewJacobian]  # of those Gaussians; may be none where nobody asks for uncertainty
    around: np.ndarray  # [N, count], the Gaussians around each
    # of a view: the component images [R, H, W, 3] that the shapes explain by the derivative at rest
    explained: Callable[[int], np.ndarray]

    def left(self, rows: Sequence[int]) -> Iterator[np.ndarray]:
        """For some of the views what the shapes leave of what they explain, [R, H, W, 3]."""
        for v in rows:
            yield self.explained(v) - self.views[v].jvp(self.shapes)


def of_halves(
    found: Found, cameras: Sequence[FixedCamera], n_timesteps: int
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """`uncertainty.safetensors`, and figures for the log, of what two halves of the cameras found."""
    halves = found.fields[..., :3]
    noise = deviation(halves[0], halves[1], found.around).astype(np.float64) ** 2
    rows = np.linspace(0, len(cameras) - 1, min(len(cameras), _VIEWS)).round().astype(int).tolist()
    views, seeing = [found.views[v] for v in rows], [cameras[v] for v in rows]
    means = found.gaussians.means.numpy()
    left = displacement_left(found.left(rows), views, seeing, means, found.around)
    variance = noise + alike(left, variation(found.shapes[..., :3], found.around))
    power = max(float((halves.mean(0) ** 2).sum()), 1e-30)
    tensors = {
        name: torch.from_numpy(np.sqrt(v / n_timesteps).astype(np.float32))
        for name, v in (("displacement", variance), ("noise", noise))
    }
    ratios = {"noise_to_motion": noise, "uncertainty_to_motion": variance}
    return tensors, {name: math.sqrt(float(v.sum()) / power) for name, v in ratios.items()}
