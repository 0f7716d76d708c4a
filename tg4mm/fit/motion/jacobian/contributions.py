"""The rendering Jacobian of one view as a list of pixel–Gaussian contributions on a torch device."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tg4mm.fit.motion.jacobian.view import ALPHA_MIN_LINEAR, ViewJacobian
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, CA, CB, CC, FEAT, MX, MY, OP, T_MIN, TILE
from tg4mm.fit.space.view import WHITE

_AT_ONCE = 1 << 22  # contributions, and candidates for one, worked on together: bounds the memory


@dataclass(frozen=True)
class DeviceViewJacobian:
    """`ViewJacobian` as M contributions of n visible Gaussians to the pixels of one view."""

    size: tuple[int, int]  # width, height
    rows: Tensor  # [n] int64, which Gaussians
    jacobian: Tensor  # [n, 8, DOF] float32, of `ViewJacobian`
    means: Tensor  # [n, 2] pixels
    conics: Tensor  # [n, 3]
    pixel: Tensor  # [M] int32, row-major
    gaussian: Tensor  # [M] int32, 0 … n − 1
    weight: Tensor  # [M] transmittance × alpha
    slope: Tensor  # [M, 3] derivative of the pixel over white by the exponent σ (alpha = o exp(−σ))

    def jvp(self, motion: Tensor) -> Tensor:
        """J m: [N, DOF] float32 -> change of the picture over white [H, W, 3]."""
        d = torch.einsum("ncd,nd->nc", self.jacobian, motion[self.rows])
        a, b, c = self.conics.unbind(1)
        # dσ = A dx² + B dx dy + C dy² + D dx + E dy, with (dx, dy) from the Gaussian's mean to the pixel
        linear = [-(a * d[:, 0] + b * d[:, 1]), -(b * d[:, 0] + c * d[:, 1])]
        table = torch.stack([d[:, 2] / 2, d[:, 3], d[:, 4] / 2, *linear, *d[:, 5:].unbind(1)], 1)
        width, height = self.size
        out = torch.zeros(height * width, 3, device=motion.device)
        for some in self._chunks():
            entries = table.index_select(0, self.gaussian[some])
            d_sigma = (entries[:, :5] * self._monomials(some)).sum(1, keepdim=True)
            change = self.weight[some].float()[:, None] * entries[:, 5:] + self.slope[some].float() * d_sigma
            out.index_add_(0, self.pixel[some], change)
        return out.reshape(height, width, 3)

    def vjp(self, picture: Tensor, v_motion: Tensor) -> None:
        """Adds Jᵀ p of a picture [H, W, 3] to `v_motion` [N, DOF]."""
        flat = picture.reshape(-1, 3)
        sums = torch.zeros(len(self.rows), 8, device=picture.device)
        for some in self._chunks():
            v = flat.index_select(0, self.pixel[some])
            v_sigma = (self.slope[some].float() * v).sum(1, keepdim=True)
            entries = torch.cat([v_sigma * self._monomials(some), self.weight[some].float()[:, None] * v], 1)
            sums.index_add_(0, self.gaussian[some], entries)
        a, b, c = self.conics.unbind(1)
        dx, dy = sums[:, 3], sums[:, 4]
        means = [-(a * dx + b * dy), -(b * dx + c * dy)]
        v_splats = torch.stack(
            [*means, sums[:, 0] / 2, sums[:, 1], sums[:, 2] / 2, *sums[:, 5:].unbind(1)], 1
        )
        v_motion.index_add_(0, self.rows, torch.einsum("ncd,nc->nd", self.jacobian, v_splats))

    def _chunks(self) -> Iterator[slice]:
        return (slice(i, i + _AT_ONCE) for i in range(0, len(self.pixel), _AT_ONCE))

    def _monomials(self, some: slice) -> Tensor:
        """[m, 5] dx², dx dy, dy², dx, dy."""
        pixel, mean = self.pixel[some], self.means.index_select(0, self.gaussian[some])
        dx = pixel % self.size[0] + 0.5 - mean[:, 0]
        dy = pixel // self.size[0] + 0.5 - mean[:, 1]
        return torch.stack([dx * dx, dx * dy, dy * dy, dx, dy], 1)


def device_view_jacobian(view: ViewJacobian, device: str, storage: torch.dtype) -> DeviceViewJacobian:
    """`view` with its contributions listed on the device; weights and slopes of type `storage`."""
    order = view.bins.order[: view.bins.n_visible]
    rank = np.zeros(len(view.splats), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    splats = torch.from_numpy(view.splats[order]).to(device)
    pairs = torch.from_numpy(rank[view.bins.pair_gaussian]).to(device)
    height, width = view.transmittance.shape
    starts = np.asarray(view.bins.tile_start, np.int64)
    parts = [_no_contributions(device, storage)]
    for tiles in _tile_groups(starts):
        parts.append(
            _contributions(splats, pairs, torch.from_numpy(tiles).to(device), (width, height), storage)
        )
    pixel, gaussian, weight, slope = (torch.cat(columns) for columns in zip(*parts, strict=True))
    return DeviceViewJacobian(
        size=(width, height),
        rows=torch.from_numpy(order.astype(np.int64)).to(device),
        jacobian=torch.from_numpy(view.jacobian).to(device),
        means=splats[:, MX : MY + 1].contiguous(),
        conics=splats[:, CA : CC + 1].contiguous(),
        pixel=pixel,
        gaussian=gaussian,
        weight=weight,
        slope=slope,
    )


def _no_contributions(device: str, storage: torch.dtype) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    index = torch.zeros(0, dtype=torch.int32, device=device)
    return index, index, index.to(storage), index.new_zeros(0, 3).to(storage)


def _tile_groups(starts: np.ndarray) -> Iterator[np.ndarray]:
    """Tiles grouped by length of list, each group [tiles, 3] int64: tile, start and length (above 0) of its list."""
    lengths = np.diff(starts)
    order = np.argsort(-lengths, kind="stable")[: np.count_nonzero(lengths)]
    first = 0
    while first < len(order):
        some = order[first : first + max(_AT_ONCE // (int(lengths[order[first]]) * TILE * TILE), 1)]
        yield np.stack([some, starts[some], lengths[some]], 1)
        first += len(some)


def _contributions(
    splats: Tensor, pairs: Tensor, tiles: Tensor, size: tuple[int, int], storage: torch.dtype
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Pixel, Gaussian, weight and slope of every contribution in tiles [t, 3]: [3DGS] Eq. (3), differentiated.

    With behind_k = Σ_{i > k} w_i c_i + T_end · white, a pixel changes by alpha_k (behind_k / (1 − alpha_k) − T_k c_k)
    for a change of σ_k.
    """
    tile, start, length = tiles.unbind(1)
    place = torch.arange(int(length.max()), device=splats.device)
    there = place < length[:, None]
    g = pairs[torch.where(there, start[:, None] + place, 0)]
    x, y = _pixels(tile, size[0])
    alpha, free = _alphas(splats, g, there, x, y)
    through = torch.cumprod(1 - alpha, 1)
    on = through > T_MIN
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], 1)
    weight = torch.where(on, before * alpha, 0.0)
    end = torch.where(on, through, 1.0).amin(1, keepdim=True)
    slopes = []
    for channel in range(FEAT, FEAT + 3):
        colour = splats[:, channel][g][:, :, None]
        contribution = weight * colour
        behind = contribution.flip(1).cumsum(1).flip(1) - contribution + WHITE * end
        slopes.append(torch.where(free & on, alpha * (behind / (1 - alpha) - before * colour), 0.0))
    inside = ((x < size[0]) & (y < size[1]))[:, None]
    t, k, p = torch.nonzero((weight > 0) & inside, as_tuple=True)
    slope = torch.stack([s[t, k, p] for s in slopes], 1)
    pixel = y[t, p] * size[0] + x[t, p]
    return pixel.int(), g[t, k].int(), weight[t, k, p].to(storage), slope.to(storage)


def _pixels(tile: Tensor, width: int) -> tuple[Tensor, Tensor]:
    """Columns and rows [t, TILE²] of the pixels of tiles [t]."""
    n_x = -(-width // TILE)
    k = torch.arange(TILE * TILE, device=tile.device)
    return (tile % n_x)[:, None] * TILE + k % TILE, (tile // n_x)[:, None] * TILE + k // TILE


def _alphas(splats: Tensor, g: Tensor, there: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Alphas [t, L, TILE²] of Gaussians g [t, L] and whether they depend on σ (not where clamped to ALPHA_MAX)."""
    s = splats[g]
    mx, my, a, b, c, opacity = (s[..., column, None] for column in (MX, MY, CA, CB, CC, OP))
    dx, dy = x[:, None] + 0.5 - mx, y[:, None] + 0.5 - my
    sigma = ((a / 2 * dx + b * dy) * dx + c / 2 * dy * dy).clamp_min(0)
    raw = opacity * torch.exp(-sigma)
    seen = (raw >= ALPHA_MIN_LINEAR) & there[:, :, None]
    return torch.where(seen, raw.clamp_max(ALPHA_MAX), 0.0), raw < ALPHA_MAX
