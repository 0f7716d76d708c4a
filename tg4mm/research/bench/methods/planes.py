"""A radiance field of three planes, as [3DMM] has it: density and colour at fixed points of space, marched along rays.

Features of the planes xy, xz, yz [3, R, R, C] (row, column: first and second coordinate) are put side by side; an MLP
of one layer gives density and 15 features, one of two layers the colour of a direction. No proposal networks: rays are
sampled in equal steps where a grid of cells says that something can be. CPU only.
"""

from dataclasses import dataclass
from itertools import pairwise

import numba
import numpy as np
import torch
from torch import Tensor, nn

from tg4mm.capture.cameras import working_box
from tg4mm.core.errors import CaptureError
from tg4mm.fit.space import RestViews
from tg4mm.fit.space.initial import in_hull

CELLS = 64  # of the grid along each side of the box
_STEPS = 128  # along the box's diagonal
_WIDTH = 64  # of the layers
_FEATURES = 15
_SHOWS = 1e-3  # a sample that weighs less has no colour
_AXES = ((0, 1), (0, 2), (1, 2))
_GROWN = 1  # pixels by which masks are


@dataclass(frozen=True)
class Place:
    """The field's extent: a cube, and its cells that are not empty."""

    box: np.ndarray  # [2, 3] float32 low and high corner, scene units
    filled: np.ndarray  # [CELLS, CELLS, CELLS] bool

    @property
    def step(self) -> float:
        """Between samples of a ray, scene units."""
        return float(np.linalg.norm(self.box[1] - self.box[0])) / _STEPS


def place_of(views: RestViews, margin: int) -> Place:
    """The visual hull of the views' alpha, grown by `margin` cells; without masks all that the cameras see together.

    Raises CaptureError where the masks leave nothing.
    """
    from scipy.ndimage import binary_dilation

    masks = binary_dilation(views.alpha > 0.02, np.ones((1, 2 * _GROWN + 1, 2 * _GROWN + 1)))
    centre, half = working_box(views.viewmats, views.Ks, views.size)
    if masks.all():
        box = np.stack([centre - half, centre + half])
    else:
        held = centres(np.stack([centre - half, centre + half]))
        held = held[in_hull(held, views, masks)]
        if not len(held):
            raise CaptureError("the masks' visual hull is empty: the cameras see nothing in common")
        reach = float(np.ptp(held, axis=0).max()) / 2 + 2 * half / CELLS
        reach *= CELLS / max(CELLS - 2 * margin, 1)  # the margin lies in the box too
        middle = (held.min(0) + held.max(0)) / 2
        box = np.stack([middle - reach, middle + reach])
    cells = in_hull(centres(box), views, masks).reshape(CELLS, CELLS, CELLS)
    return Place(box.astype(np.float32), binary_dilation(cells, np.ones((2 * margin + 1,) * 3)))


def centres(box: np.ndarray) -> np.ndarray:
    """Return [CELLS³, 3] float32."""
    unit = (np.arange(CELLS) + 0.5) / CELLS
    grid = np.stack(np.meshgrid(unit, unit, unit, indexing="ij"), -1).reshape(-1, 3)
    return (box[0] + grid * (box[1] - box[0])).astype(np.float32)


def rays_of(viewmats: np.ndarray, ks: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return (origins, unit directions), each [V · H · W, 3] float32, of all pixels' centres; size (width, height)."""
    v, u = np.meshgrid(np.arange(size[1]) + 0.5, np.arange(size[0]) + 0.5, indexing="ij")
    pixels = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3)
    found = []
    for viewmat, k in zip(viewmats.astype(np.float64), ks.astype(np.float64), strict=True):
        directions = pixels @ np.linalg.inv(k).T @ viewmat[:3, :3]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        directions[np.abs(directions) < 1e-9] = 1e-9  # a ray along a face would divide by zero
        found.append((np.broadcast_to(-viewmat[:3, 3] @ viewmat[:3, :3], directions.shape), directions))
    return tuple(np.concatenate([f[i] for f in found]).astype(np.float32) for i in (0, 1))


@numba.njit(cache=True)
def march(origins, directions, box, filled, step, start):
    """Samples of rays [B, 3] in filled cells: (ray [S] int64, distance [S] float32), a ray's own one after another.

    start [B] in 0..1: where in the first step its samples begin.
    """
    cells, most = len(filled), 2 * _STEPS
    ray, distance = np.empty(len(origins) * most, np.int64), np.empty(len(origins) * most, np.float32)
    n = 0
    for r in range(len(origins)):
        near, far = 0.0, 1e30
        for a in range(3):
            low, high = (
                (box[0, a] - origins[r, a]) / directions[r, a],
                (box[1, a] - origins[r, a]) / directions[r, a],
            )
            near, far = max(near, min(low, high)), min(far, max(low, high))
        for i in range(most):
            t = near + (start[r] + i) * step
            if t >= far:
                break
            inside = True
            at = np.empty(3, np.int64)
            for a in range(3):
                at[a] = int(
                    (origins[r, a] + t * directions[r, a] - box[0, a]) / (box[1, a] - box[0, a]) * cells
                )
                inside = inside and 0 <= at[a] < cells
            if inside and filled[at[0], at[1], at[2]]:
                ray[n], distance[n] = r, t
                n += 1
    return ray[:n], distance[:n]


@numba.njit(inline="always")
def _corner(x, resolution):
    """The first of the two cells that a place in 0..1 lies between, and the weights of both."""
    position = min(max(x, np.float32(0)), np.float32(1)) * np.float32(resolution - 1)
    first = min(int(position), resolution - 2)
    second = position - np.float32(first)
    return first, np.float32(1) - second, second


@numba.njit(cache=True)
def _gather(planes, points, out):
    """out [P, 3 C]: planes [3, R, R, C], bilinear at points [P, 3] in 0..1."""
    _, resolution, _, channels = planes.shape
    for p in range(len(points)):
        for k in range(3):
            i, low, high = _corner(points[p, 0 if k < 2 else 1], resolution)
            j, left, right = _corner(points[p, 1 if k == 0 else 2], resolution)
            a, b, c, d = low * left, low * right, high * left, high * right
            own = out[p, k * channels : (k + 1) * channels]
            v, w = planes[k, i, j], planes[k, i, j + 1]
            x, y = planes[k, i + 1, j], planes[k, i + 1, j + 1]
            for n in range(channels):
                own[n] = a * v[n] + b * w[n] + c * x[n] + d * y[n]


@numba.njit(cache=True)
def _scatter(values, points, planes):
    """The transpose: planes [3, R, R, C] += values [P, 3 C]."""
    _, resolution, _, channels = planes.shape
    for p in range(len(points)):
        for k in range(3):
            i, low, high = _corner(points[p, 0 if k < 2 else 1], resolution)
            j, left, right = _corner(points[p, 1 if k == 0 else 2], resolution)
            own = values[p, k * channels : (k + 1) * channels]
            for at, weight in (
                (planes[k, i, j], low * left),
                (planes[k, i, j + 1], low * right),
                (planes[k, i + 1, j], high * left),
                (planes[k, i + 1, j + 1], high * right),
            ):
                for n in range(channels):
                    at[n] += weight * own[n]


class _Sample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, planes: Tensor, points: Tensor) -> Tensor:
        out = torch.empty(len(points), 3 * planes.shape[3])
        _gather(planes.detach().contiguous().numpy(), points.numpy(), out.numpy())
        ctx.points, ctx.shape = points, planes.shape
        return out

    @staticmethod
    def backward(ctx, *grads: Tensor) -> tuple[Tensor, None]:
        planes = torch.zeros(ctx.shape)
        _scatter(grads[0].contiguous().numpy(), ctx.points.numpy(), planes.numpy())
        return planes, None


def sample(planes: Tensor, points: Tensor) -> Tensor:
    """Features [P, 3 C] of planes [3, R, R, C] float32 at points [P, 3] float32 in 0..1, bilinear."""
    return _Sample.apply(planes, points)


def harmonics(directions: Tensor) -> Tensor:
    """Return [P, 9] real spherical harmonics to degree 2 of unit directions [P, 3]."""
    x, y, z = directions.unbind(1)
    squares = [0.5462742 * (x * x - y * y), 0.3153916 * (3 * z * z - 1)]
    pairs = [1.0925484 * a * b for a, b in ((x, y), (y, z), (x, z))]
    return torch.stack(
        [torch.full_like(x, 0.2820948), *(0.4886025 * a for a in (x, y, z)), *pairs, *squares], 1
    )


class PlaneField(nn.Module):
    """The planes and the two MLPs in a `Place`."""

    def __init__(self, place: Place, resolution: int, channels: int, generator: torch.Generator) -> None:
        super().__init__()
        self.place = place
        shape = (3, resolution, resolution, channels)
        self.planes = nn.Parameter(0.1 + 0.1 * torch.rand(shape, generator=generator))
        self.density = _mlp((3 * channels, _WIDTH, 1 + _FEATURES), generator)
        self.colour = _mlp((_FEATURES + 9, _WIDTH, _WIDTH, 3), generator)

    def render(
        self,
        planes: Tensor,
        rays: tuple[Tensor, Tensor],
        behind: Tensor,
        start: Tensor,
        place: Place | None = None,
    ) -> Tensor:
        """Colours [B, 3] of rays (origins, directions) over `behind` [B, 3]; planes in place of the field's own.

        start [B]: of `march`. place: where there are samples, if not where the field is.
        """
        place, (origins, directions) = place or self.place, rays
        ray, distance = (
            torch.from_numpy(a)
            for a in march(
                origins.numpy(), directions.numpy(), place.box, place.filled, place.step, start.numpy()
            )
        )
        low, high = torch.from_numpy(place.box)
        points = (origins[ray] + distance[:, None] * directions[ray] - low) / (high - low)
        found = self.density(sample(planes, points))
        thickness = found[:, 0].clamp(max=7.0).exp().double() * place.step
        before = thickness.cumsum(0) - thickness
        count = torch.bincount(ray, minlength=len(origins))
        first = (count.cumsum(0) - count)[ray]
        # of what a ray has behind it, its own samples alone
        weight = ((before[first] - before).exp() * -torch.expm1(-thickness)).float()
        shown = (weight.detach() > _SHOWS).nonzero()[:, 0]
        towards = torch.cat([found[shown, 1:], harmonics(directions[ray[shown]])], 1)
        colour = weight[shown, None] * self.colour(towards).sigmoid()
        cover = torch.zeros(len(origins)).index_add(0, ray, weight)
        return ((1 - cover[:, None]) * behind).index_add(0, ray[shown], colour)


def _mlp(widths: tuple[int, ...], generator: torch.Generator) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in pairwise(widths):
        layer = nn.Linear(a, b)
        with torch.no_grad():
            bound = a**-0.5  # torch's own, by this generator
            layer.weight.copy_((2 * torch.rand(b, a, generator=generator) - 1) * bound)
            layer.bias.copy_((2 * torch.rand(b, generator=generator) - 1) * bound)
        layers += [layer, nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def total_variation(planes: Tensor) -> Tensor:
    """Mean square difference of neighbours along rows and along columns of planes [3, R, R, C]."""
    return planes.diff(dim=1).square().mean() + planes.diff(dim=2).square().mean()
