"""The Gaussian decoder: five heads of GELU and a linear layer that give residuals to base attributes, [TG4MM] Eq. (8).

Residuals are added before activation: to the log of the scale, the logit of the opacity, the quaternion before it is
normalised, position and SH as they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import gelu, linear

from tg4mm.fit.gaussians import Gaussians

BASE = (
    "means",
    "quats",
    "log_scales",
    "logits",
    "sh",
)  # attributes before activation, in the order of the heads


@dataclass(frozen=True)
class Decoder:
    """Parameters by name: `<head>.weight` [D, width], `<head>.bias` [D], and of the MLP `mlp<i>.weight`, `.bias`."""

    parameters: dict[str, Tensor]

    @property
    def n_layers(self) -> int:
        """Layers of the MLP before the heads; 0 is "decoder only" in [TG4MM] Table VI."""
        return sum(name.startswith("mlp") and name.endswith("weight") for name in self.parameters)

    def residuals(self, embedding: Tensor) -> dict[str, Tensor]:
        """{head: [N, D]} from an embedding [N, 3 C]."""
        p, x = self.parameters, embedding
        for i in range(self.n_layers):
            x = torch.relu(linear(x, p[f"mlp{i}.weight"], p[f"mlp{i}.bias"]))
        x = gelu(x)  # every head begins with it
        weight = torch.cat([p[f"{head}.weight"] for head in BASE])
        bias = torch.cat([p[f"{head}.bias"] for head in BASE])
        parts = linear(x, weight, bias).split([len(p[f"{head}.bias"]) for head in BASE], 1)
        return dict(zip(BASE, parts, strict=True))

    def decode(self, base: Mapping[str, Tensor], embedding: Tensor) -> Gaussians:
        """The Gaussians of an embedding [N, 3 C] on top of `base` (`base_of`); gradients flow to all three."""
        d = self.residuals(embedding)
        return Gaussians(
            base["means"] + d["means"],
            base["quats"] + d["quats"],
            (base["log_scales"] + d["log_scales"]).exp(),
            (base["logits"] + d["logits"][:, 0]).sigmoid(),
            base["sh"] + d["sh"].reshape(base["sh"].shape),
        )


def new_decoder(channels: int, n_sh: int, layers: int, width: int, generator: torch.Generator) -> Decoder:
    """A decoder for embeddings of `channels` = 3 C and n_sh SH coefficients; `layers` × `width` MLP before the heads.

    Weights are random, He's normal in the MLP, Glorot's uniform in the heads; biases are zero. Heads that started at
    zero would stay small on base Gaussians that fit already, and small heads hardly answer to motion planes.
    """
    parameters: dict[str, Tensor] = {}
    n_in = channels
    for i in range(layers):
        deviation = math.sqrt(2 / n_in)
        parameters[f"mlp{i}.weight"] = torch.randn(width, n_in, generator=generator) * deviation
        parameters[f"mlp{i}.bias"] = torch.zeros(width)
        n_in = width
    for head, size in zip(BASE, (3, 4, 3, 1, 3 * n_sh), strict=True):
        bound = math.sqrt(6 / (size + n_in))
        parameters[f"{head}.weight"] = (2 * torch.rand(size, n_in, generator=generator) - 1) * bound
        parameters[f"{head}.bias"] = torch.zeros(size)
    return Decoder(parameters)


def base_below(gaussians: Gaussians, decoder: Decoder, embedding: Tensor) -> dict[str, Tensor]:
    """The base on top of which `embedding` [N, 3 C] decodes to the Gaussians."""
    with torch.no_grad():
        residuals = decoder.residuals(embedding)
    return {k: v - residuals[k].reshape(v.shape) for k, v in base_of(gaussians).items()}


def base_of(gaussians: Gaussians) -> dict[str, Tensor]:
    """Attributes before activation. Opacities are held within 1e-6 of 0 and 1, scales above 1e-12."""
    g = gaussians
    return {
        "means": g.means.clone(),
        "quats": torch.nn.functional.normalize(g.quats, dim=1),
        "log_scales": g.scales.clamp_min(1e-12).log(),
        "logits": g.opacities.clamp(1e-6, 1 - 1e-6).logit(),
        "sh": g.sh.clone(),
    }
