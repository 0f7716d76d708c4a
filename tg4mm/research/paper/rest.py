"""What the frozen model gets wrong at timestep 0, picture by picture: what the difference loss takes out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from tg4mm.core.errors import CaptureError
from tg4mm.fit.space import RestViews
from tg4mm.fit.space.view import render_view
from tg4mm.research.paper.model import PaperModel


@dataclass(frozen=True)
class AtRest:
    """The cameras of timestep 0 and, of each, rendered less picture."""

    viewmats: np.ndarray  # [V, 4, 4] float32
    Ks: np.ndarray  # [V, 3, 3] float32
    missing: np.ndarray  # [V, H, W, 3] float32: rendered at rest − picture of timestep 0

    def row_of(self, views: RestViews, v: int) -> int:
        """Which of these cameras took picture v of `views`. Raises CaptureError if it had moved since timestep 0."""
        same = (self.viewmats == views.viewmats[v]).all((1, 2)) & (self.Ks == views.Ks[v]).all((1, 2))
        if not same.any():
            raise CaptureError(
                "setting paper.difference is true, which needs fixed cameras, but a camera moved"
            )
        return int(same.argmax())


@torch.no_grad()
def at_rest(model: PaperModel, views: RestViews) -> AtRest:
    """Render the model at rest from the cameras of timestep 0, over white."""
    gaussians = model.rest()
    size = views.rgb.shape[2], views.rgb.shape[1]
    rendered = [
        render_view(
            gaussians, torch.from_numpy(viewmat), torch.from_numpy(K), size, gaussians.sh_degree
        ).rgb.numpy()
        for viewmat, K in zip(views.viewmats, views.Ks, strict=True)
    ]
    return AtRest(views.viewmats, views.Ks, np.stack(rendered) - views.rgb)
