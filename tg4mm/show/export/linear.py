"""Gaussians for viewers that have no low-pass and blend in linear light, as Blender's own splats do.

Training blends display colours. Blended in linear light the same Gaussians are brighter wherever bright and dark ones
overlap, which no width mends. So scales, opacities and colours are fitted, by the training cameras, to what the
rasteriser draws of the run; positions and motion stay.
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from tg4mm.capture import Capture
from tg4mm.core.progress import progress
from tg4mm.core.splatfile.formula import harmonics
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.space.view import near_plane
from tg4mm.show.export.lowpass import BAKED_PX2, smoothing_variance, widened

ITERATIONS = 300  # pictures, by which the error has stopped falling
_LAST = 0.1  # of the learning rates, at the end
_RATES = {"logs": 0.01, "logits": 0.03, "sh": 0.01}
# Of Cycles' pixel filter, Blackman-Harris over 1.5 pixels: variance, square pixels.
_FILTER_PX2 = 0.04
_MARGIN = 1e-4  # of opacities, from 0 and 1


def fitted_to_linear(gaussians: Gaussians, capture: Capture, iterations: int = ITERATIONS) -> Gaussians:
    """Return Gaussians that look blended in linear light, without a low-pass, as these do in `rasterization`."""
    g = gaussians.to("cpu").detach()
    variance = smoothing_variance(g.means.numpy().astype(np.float64), capture)
    values = {
        "logs": torch.as_tensor(np.log(widened(g.scales.numpy(), variance)), dtype=torch.float32),
        "logits": torch.logit(g.opacities.clamp(_MARGIN, 1 - _MARGIN)),
        "sh": g.sh.clone(),
    }
    groups = [
        {"params": [value.requires_grad_()], "lr": _RATES[name], "eps": 1e-12}
        for name, value in values.items()
    ]
    optimizer = torch.optim.Adam(groups)
    _, cameras = np.unique(capture.camera_ids, return_index=True)
    rng = np.random.default_rng(0)
    with progress("fitting to linear light", iterations, "pictures") as update:
        for done in range(1, iterations + 1):
            row, behind = rng.choice(cameras), rng.random()
            view = _View.of(capture, int(row), g)
            fitted = replace(
                g, scales=values["logs"].exp(), opacities=values["logits"].sigmoid(), sh=values["sh"]
            )
            with torch.no_grad():
                wanted = view.trained(g, behind)
            loss = (view.linear(fitted, behind) - wanted).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            for group in optimizer.param_groups:
                group["lr"] *= _LAST ** (1 / iterations)
            update(done)
    return replace(
        g, scales=values["logs"].exp(), opacities=values["logits"].sigmoid(), sh=values["sh"]
    ).detach()


class _View:
    """One training camera."""

    def __init__(
        self, viewmat: np.ndarray, K: np.ndarray, size: tuple[int, int], basis: Tensor, near: float
    ) -> None:
        self.viewmats, self.Ks = (torch.as_tensor(m, dtype=torch.float32)[None] for m in (viewmat, K))
        self.size, self.basis, self.near = size, basis, near

    @classmethod
    def of(cls, capture: Capture, row: int, gaussians: Gaussians) -> "_View":
        viewmat = capture.viewmats[row]
        toward = gaussians.means.numpy() + viewmat[:3, :3].T @ viewmat[:3, 3]
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        basis = torch.as_tensor(harmonics(toward)[:, : gaussians.sh.shape[1]], dtype=torch.float32)
        size = capture.width, capture.height
        return cls(viewmat, capture.Ks[row], size, basis, near_plane(gaussians.means, viewmat))

    def trained(self, gaussians: Gaussians, behind: float) -> Tensor:
        """Return the rasteriser's picture [H, W, 3] over a grey of `behind`."""
        rgb, alpha = self._drawn(gaussians, self._colours(gaussians), BAKED_PX2)
        return (rgb + (1 - alpha) * behind).clamp(0, 1)

    def linear(self, gaussians: Gaussians, behind: float) -> Tensor:
        """Return the picture blended in linear light, then over a grey as a picture with straight alpha is."""
        rgb, alpha = self._drawn(gaussians, _to_linear(self._colours(gaussians).clamp(0, 1)), _FILTER_PX2)
        return _to_display((rgb / alpha.clamp_min(_MARGIN)).clamp(0, 1)) * alpha + (1 - alpha) * behind

    def _colours(self, gaussians: Gaussians) -> Tensor:
        return ((self.basis[:, :, None] * gaussians.sh).sum(1) + 0.5).clamp_min(0)

    def _drawn(self, g: Gaussians, colours: Tensor, low_pass: float) -> tuple[Tensor, Tensor]:
        arrays = (g.means, g.quats, g.scales, g.opacities, colours, self.viewmats, self.Ks)
        rgb, alpha, _ = rasterization(*arrays, *self.size, near_plane=self.near, eps2d=low_pass)
        return rgb[0], alpha[0]


# As core/colour.py, with gradients.
def _to_linear(x: Tensor) -> Tensor:
    return torch.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def _to_display(x: Tensor) -> Tensor:
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(1e-6) ** (1 / 2.4) - 0.055)
