"""Networks of the paper's method: feature planes by numba kernels, [TG4MM] Eq. (4) and (5), and their decoder.

The decoder is [TG4MM] Eq. (8): residuals are added before activation: to the log of the scale, the logit of the
opacity, the quaternion before it is normalised, position and SH as they are.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import gelu, linear

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize.kernels.compiled import shared

PLANES = ((0, 1), (0, 2), (1, 2))  # xy, xz, yz: the coordinates along columns and rows
_OUTER = (0.5, 99.5)  # percentiles of the points that the box spans; points beyond lie on its border
BASE = (
    "means",
    "quats",
    "log_scales",
    "logits",
    "sh",
)  # attributes before activation, in the order of the heads


class _TriplaneSample(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, cells: "TouchedCells") -> Tensor:
        out = torch.empty(cells.index.shape[1], 3 * values.shape[1])
        gather(values.detach().contiguous().numpy(), cells.index, cells.weight, out.numpy())
        ctx.cells, ctx.channels = cells, values.shape[1]
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        c = ctx.cells
        v_values = torch.empty(len(c), ctx.channels)
        v_out = grads[0].contiguous().numpy()
        gather_back(v_out, c.first, c.point, c.plane, c.share, v_values.numpy())
        return v_values, None


def sample(values: Tensor, cells: "TouchedCells") -> Tensor:
    """Embedding [N, 3 C] of the points from values [A, C] float32 of the active cells; concatenated xy, xz, yz.

    CPU tensors go to numba kernels, others through torch (whose sums of gradients run by atomics on CUDA).
    Raises ValueError for values of another shape.
    """
    if values.ndim != 2 or len(values) != len(cells):
        raise ValueError(f"values have shape {tuple(values.shape)}, expected ({len(cells)}, channels)")
    if values.device.type == "cpu" and values.dtype == torch.float32:
        return _TriplaneSample.apply(values, cells)
    return sample_torch(values, cells)


def sample_torch(values: Tensor, cells: "TouchedCells") -> Tensor:
    """The same by torch's own operations, on any device and in any precision."""
    index, weight = _on(cells, values.device)
    parts = (values[index] * weight.to(values.dtype)[..., None]).sum(2)  # [3, N, C]
    return torch.cat(list(parts), 1)


@lru_cache(maxsize=2)
def _on(cells: "TouchedCells", device: torch.device) -> tuple[Tensor, Tensor]:
    """Index and weight, brought to a device once."""
    return torch.from_numpy(cells.index.astype(np.int64)).to(device), torch.from_numpy(cells.weight).to(
        device
    )


@shared
def gather(
    worker: int, workers: int, values: np.ndarray, index: np.ndarray, weight: np.ndarray, out: np.ndarray
) -> None:
    """out [N, 3 C] = Σ_j weight · values[index]: values [A, C], index and weight [3, N, 4]."""
    channels = values.shape[1]
    for n in range(worker, index.shape[1], workers):
        for k in range(3):
            a, b, c, d = index[k, n, 0], index[k, n, 1], index[k, n, 2], index[k, n, 3]
            wa, wb, wc, wd = weight[k, n, 0], weight[k, n, 1], weight[k, n, 2], weight[k, n, 3]
            for i in range(channels):
                out[n, k * channels + i] = (
                    wa * values[a, i] + wb * values[b, i] + wc * values[c, i] + wd * values[d, i]
                )


@shared
def gather_back(
    worker: int,
    workers: int,
    v_out: np.ndarray,
    first: np.ndarray,
    point: np.ndarray,
    plane: np.ndarray,
    share: np.ndarray,
    v_values: np.ndarray,
) -> None:
    """The transpose: v_values [A, C] from v_out [N, 3 C]; entries of every cell as in `TouchedCells`."""
    channels = v_values.shape[1]
    for a in range(worker, len(first) - 1, workers):
        for i in range(channels):
            v_values[a, i] = 0.0
        for e in range(first[a], first[a + 1]):
            n, at, w = point[e], plane[e] * channels, share[e]
            for i in range(channels):
                v_values[a, i] += w * v_out[n, at + i]


@dataclass(frozen=True, eq=False)
class TouchedCells:
    """A cells of three R×R planes, touched by N points; all indices are into the A compact cells.

    A point's value on plane k is Σ_j weight[k, n, j] · values[index[k, n, j]].
    """

    resolution: int  # R
    dense: np.ndarray  # [A] int64, k · R² + row · R + column, ascending
    index: np.ndarray  # [3, N, 4] int32
    weight: np.ndarray  # [3, N, 4] float32, each four sum to 1
    first: np.ndarray  # [A + 1] int32: entries first[a] … first[a + 1] − 1 of the next three belong to cell a
    point: np.ndarray  # [12 N] int32
    plane: np.ndarray  # [12 N] int8
    share: np.ndarray  # [12 N] float32, the weights again

    def __len__(self) -> int:
        return len(self.dense)

    def of_plane(self, k: int) -> slice:
        """The compact cells of plane k."""
        size = self.resolution**2
        return slice(*(int(np.searchsorted(self.dense, size * i)) for i in (k, k + 1)))


def scene_box(points: np.ndarray) -> np.ndarray:
    """Return [2, 3] low and high corner of the points [N, 3], but for the outermost half percent on each side."""
    low, high = np.percentile(points, _OUTER, axis=0)
    return np.stack([low, np.maximum(high, low + 1e-6)])


def cells_of(points: np.ndarray, box: np.ndarray, resolution: int) -> TouchedCells:
    """The cells that points [N, 3] touch; `box` [2, 3] is normalised to 0..1, cell centres on its border included.

    As `grid_sample` with `align_corners=True, padding_mode="border"` on planes whose rows are the second coordinate.
    """
    unit = np.clip((points.astype(np.float64) - box[0]) / (box[1] - box[0]), 0, 1)
    position = unit * (resolution - 1)
    corner = np.minimum(position.astype(np.int64), resolution - 2)
    fraction = position - corner
    index = np.empty((3, len(points), 4), np.int64)
    weight = np.empty((3, len(points), 4), np.float32)
    for k, (u, v) in enumerate(PLANES):
        for j, (du, dv) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
            index[k, :, j] = (k * resolution + corner[:, v] + dv) * resolution + corner[:, u] + du
            wu = fraction[:, u] if du else 1 - fraction[:, u]
            weight[k, :, j] = wu * (fraction[:, v] if dv else 1 - fraction[:, v])
    dense, compact = np.unique(index.ravel(), return_inverse=True)
    order = np.argsort(compact, kind="stable")
    n = len(points)
    return TouchedCells(
        resolution=resolution,
        dense=dense,
        index=compact.reshape(index.shape).astype(np.int32),
        weight=weight,
        first=np.concatenate([[0], np.cumsum(np.bincount(compact, minlength=len(dense)))]).astype(np.int32),
        point=((order // 4) % n).astype(np.int32),
        plane=(order // (4 * n)).astype(np.int8),
        share=weight.ravel()[order],
    )


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
