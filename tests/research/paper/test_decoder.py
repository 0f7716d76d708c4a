"""The decoder: starts at the base, has five heads, and passes gradients to all it is made of."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import gelu

from tg4mm.fit.gaussians import Gaussians
from tg4mm.research.paper.decoder import BASE, base_below, base_of, new_decoder


@pytest.fixture
def gaussians() -> Gaussians:
    g = torch.Generator().manual_seed(0)
    return Gaussians(
        torch.randn(5, 3, generator=g), torch.randn(5, 4, generator=g), torch.rand(5, 3, generator=g) + 0.01,
        torch.rand(5, generator=g) * 0.9 + 0.05, torch.randn(5, 16, 3, generator=g),
    )  # fmt: skip


@pytest.mark.parametrize("layers", [0, 8])
def test_on_the_base_below_them_an_embedding_decodes_to_the_gaussians(gaussians, layers):
    decoder = new_decoder(12, 16, layers, 32, torch.Generator().manual_seed(0))
    embedding = torch.randn(5, 12)
    out = decoder.decode(base_below(gaussians, decoder, embedding), embedding)
    assert decoder.n_layers == layers
    assert all(decoder.parameters[f"{head}.weight"].any() for head in BASE)
    for name in ("means", "scales", "opacities", "sh"):
        torch.testing.assert_close(getattr(out, name), getattr(gaussians, name))
    torch.testing.assert_close(out.quats, torch.nn.functional.normalize(gaussians.quats, dim=1))


def test_heads_are_gelu_and_linear_on_attributes_before_activation(gaussians):
    g = torch.Generator().manual_seed(1)
    decoder = new_decoder(6, 16, 0, 0, g)
    for p in decoder.parameters.values():
        p += torch.randn(p.shape, generator=g) * 0.1
    x = torch.randn(5, 6, generator=g)
    out, base = decoder.decode(base_of(gaussians), x), base_of(gaussians)
    residual = {
        h: gelu(x) @ decoder.parameters[f"{h}.weight"].T + decoder.parameters[f"{h}.bias"] for h in BASE
    }
    torch.testing.assert_close(out.means, base["means"] + residual["means"])
    torch.testing.assert_close(out.scales, (base["log_scales"] + residual["log_scales"]).exp())
    torch.testing.assert_close(out.opacities, (base["logits"] + residual["logits"][:, 0]).sigmoid())
    torch.testing.assert_close(out.sh, base["sh"] + residual["sh"].reshape(5, 16, 3))


def test_gradients_reach_embedding_base_and_decoder(gaussians):
    g = torch.Generator().manual_seed(1)
    decoder = new_decoder(6, 16, 2, 8, g)
    parameters = {
        k: (v + 0.1 * torch.randn(v.shape, generator=g)).requires_grad_()
        for k, v in decoder.parameters.items()
    }
    base = {k: v.requires_grad_() for k, v in base_of(gaussians).items()}
    x = torch.randn(5, 6, generator=g).requires_grad_()
    out = type(decoder)(parameters).decode(base, x)
    sum((getattr(out, n) ** 2).sum() for n in ("means", "quats", "scales", "opacities", "sh")).backward()
    for tensor in [x, *base.values(), *parameters.values()]:
        assert tensor.grad is not None
        assert tensor.grad.any()
