"""The scene of a single camera that never moves: its mean picture, as Gaussians on a plane.

The cells of a quadtree, fine where the picture has detail, become discs at distance 1: with given positions and sizes
the picture is linear in the colours, which are found by conjugate gradients. Discs let part of the coarser ones below
shine through: opaque ones would have a wrong slope, from which motion is estimated, and gaps where they move apart.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation
from torch import Tensor

from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.memory import peak_memory_mib
from tg4mm.core.progress import progress
from tg4mm.fit.device import full_precision, gpu_figures, reset_gpu_peak
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.space.config import SpaceConfig, checked
from tg4mm.fit.space.parameters import SH_C0
from tg4mm.fit.space.targets import RestViews
from tg4mm.fit.space.train import SpaceFit
from tg4mm.fit.space.view import EPS2D, FAR, NEAR, WHITE, render_view

FINEST, COARSEST = 2, 32  # cells' sides, pixels
DETAIL = 0.5 / 255  # rms: a cell of less is not split, it holds what rounding and noise left
PIXELS_PER_GAUSSIAN = 9
MOST = 120_000  # unless asked for: the motion stage's time grows with them
FEWEST = 16
WIDTH, OPACITY = 0.5, 0.6  # of a disc: standard deviation by its cell's side
THICKNESS = 0.01  # by the standard deviation
BACKDROP_SIDE, BACKDROP_WIDTH, BACKDROP_OPACITY = 2, 0.8, 0.99  # sides by those of the coarsest cells
STEP = 2e-5  # of depth from one rank to the next; some hundred ranks stay within 0.3 % of distance 1
ITERATIONS = 14
RIDGE = 0.02  # holds colours to their cells' mean; overshooting neighbours would tear when they move apart
# Within 4 × 4 cells each has a rank of its own: discs that overlap keep their order when they move
_BAYER = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])


@dataclass(frozen=True)
class Squares:
    """Squares on a picture; those at its right and lower edge may reach over it."""

    centres: np.ndarray  # [N, 2] pixels
    sides: np.ndarray  # [N] pixels, powers of two
    colours: np.ndarray  # [N, 3] mean over the cell; what lies outside repeats the edge


def quadtree(picture: np.ndarray, budget: int, coarsest: int = COARSEST) -> Squares:
    """Return at most `budget` cells (at least the coarsest ones): all nodes of the tree, the coarsest first.

    picture: [H, W, 3]. A cell is split while its squared deviation, summed over pixels and channels, is among the
    largest and above noise; it stays below its children. These deviate less than it does, all four together, so one
    threshold serves all sizes.
    """
    height, width = picture.shape[:2]
    levels = _pyramid(picture, coarsest)
    deviations = np.sort(np.concatenate([sums.ravel() for _, _, sums in levels[:-1]]))[::-1]
    splits = max(budget - levels[0][2].size, 0) // 4
    threshold = deviations[splits] if splits < len(deviations) else 0.0
    active = np.ones(levels[0][2].shape, bool)
    found = []
    for side, means, sums in levels:
        above = sums > max(threshold, 3 * side**2 * DETAIL**2)
        split = active & above & (side > FINEST)
        rows, columns = np.nonzero(active)
        centres = np.stack([columns + 0.5, rows + 0.5], 1) * side
        found.append((centres, np.full(len(rows), side), means[rows, columns]))
        active = split.repeat(2, 0).repeat(2, 1)
    centres, sides, colours = (np.concatenate(parts) for parts in zip(*found, strict=True))
    inside = (centres - sides[:, None] / 2 < [width, height]).all(1)
    return Squares(centres[inside], sides[inside], colours[inside])


def _pyramid(picture: np.ndarray, coarsest: int) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Side, means [h, w, 3] and summed squared deviations [h, w] of cells of every size, the coarsest first."""
    height, width = picture.shape[:2]
    missing = (-height % coarsest, -width % coarsest)
    padded = np.pad(picture.astype(np.float64), (*((0, m) for m in missing), (0, 0)), mode="edge")
    sums, squares, side = padded, (padded**2).sum(-1), 1
    levels = []
    while side < coarsest:
        sums, squares, side = _fours(sums), _fours(squares), 2 * side
        if side >= FINEST:
            means = sums / side**2
            levels.append((side, means, np.maximum(squares - side**2 * (means**2).sum(-1), 0.0)))
    return levels[::-1]


def _fours(a: np.ndarray) -> np.ndarray:
    """Sums over 2 × 2 blocks of the first two axes."""
    rows = a[::2] + a[1::2]
    return np.asarray(rows[:, ::2] + rows[:, 1::2])


def plane_gaussians(picture: np.ndarray, K: np.ndarray, viewmat: np.ndarray, budget: int) -> Gaussians:
    """Discs at distance 1 before a camera, one a cell of the quadtree, coloured by the cells' means, and a backdrop.

    picture: [H, W, 3] in 0..1; K [3, 3], viewmat [4, 4] world-to-camera; budget: most Gaussians. Finer discs lie before
    coarser ones; behind all is a layer that lets no background through. Raises Tg4mmError for a budget below `FEWEST`.
    """
    if budget < FEWEST:
        raise Tg4mmError(f"setting space.max_gaussians is {budget}, expected >= {FEWEST} for a flat capture")
    coarsest = _coarsest(picture.shape, budget)
    behind = _backdrop(picture, BACKDROP_SIDE * coarsest)
    cells = quadtree(picture, budget - len(behind.sides), coarsest)
    uv = np.concatenate([cells.centres, behind.centres])
    widths = np.concatenate([WIDTH * cells.sides, BACKDROP_WIDTH * behind.sides])  # pixels
    opacities = np.repeat([OPACITY, BACKDROP_OPACITY], [len(cells.sides), len(behind.sides)])
    depth = 1 + STEP * np.concatenate([_ranks(cells), _ranks(behind)])
    rays = np.concatenate([uv, np.ones((len(uv), 1))], 1) @ np.linalg.inv(K.astype(np.float64)).T
    rotation, shift = viewmat[:3, :3].astype(np.float64), viewmat[:3, 3].astype(np.float64)
    scales = widths[:, None] / np.array([K[0, 0], K[1, 1], K[0, 0] / THICKNESS]) * depth[:, None]
    colours = np.concatenate([cells.colours, behind.colours])
    wxyz = np.roll(Rotation.from_matrix(rotation.T).as_quat(), 1)
    return Gaussians(
        means=torch.from_numpy((rays * depth[:, None] - shift) @ rotation).float(),
        quats=torch.from_numpy(wxyz).float().repeat(len(uv), 1),
        scales=torch.from_numpy(scales).float(),
        opacities=torch.from_numpy(opacities).float(),
        sh=_sh(torch.from_numpy(colours).float()),
    )


def _coarsest(shape: tuple[int, ...], budget: int) -> int:
    """Side of the coarsest cells, larger where a small budget would be used up by them."""
    side = COARSEST
    while 2 * (-(-shape[0] // side) + 3) * (-(-shape[1] // side) + 3) > budget and side < max(shape):
        side *= 2
    return side


def _backdrop(picture: np.ndarray, side: int) -> Squares:
    """Return a regular grid that extends over the edges of the picture, in the colours below."""
    height, width = picture.shape[:2]
    rows, columns = (side * np.arange(-(-n // side) + 1) for n in (height, width))
    v, u = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    colours = picture[np.minimum(v, height - 1), np.minimum(u, width - 1)].astype(np.float64)
    return Squares(np.stack([u, v], 1).astype(np.float64), np.full(len(u), side), colours)


def _ranks(cells: Squares) -> np.ndarray:
    """Return [N] places in the order of depth: by size, then so that neighbours differ."""
    columns, rows = (cells.centres // cells.sides[:, None]).astype(int).T % 4
    return 16 * (np.log2(cells.sides) - np.log2(FINEST)) + _BAYER[rows, columns]


def _sh(colours: Tensor) -> Tensor:
    return ((colours - 0.5) / SH_C0)[:, None]


class _Blending:
    """The linear map A from colours [N, 3] to a picture [H, W, 3], and the light that comes through from behind."""

    def __init__(self, gaussians: Gaussians, viewmat: Tensor, K: Tensor, size: tuple[int, int]) -> None:
        g = gaussians
        self._geometry = (g.means, g.quats, g.scales, g.opacities)
        self._camera, self._size = (viewmat[None], K[None]), size

    def picture(self, colours: Tensor) -> tuple[Tensor, Tensor]:
        """A x, and what is behind: [H, W, 3], [H, W, 1]."""
        image, alpha, _ = rasterization(
            *self._geometry, colours, *self._camera, *self._size, NEAR, FAR, EPS2D
        )
        return image[0], WHITE * (1 - alpha[0])

    def with_adjoint(self, colours: Tensor, against: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """A x and Aᵀ b, b = `against` [H, W, 3], or A x itself."""
        x = colours.detach().requires_grad_()
        image, _ = self.picture(x)
        b = image.detach() if against is None else against
        (gradient,) = torch.autograd.grad((image * b).sum(), x)
        return image.detach(), gradient


def solve_colours(
    gaussians: Gaussians,
    picture: np.ndarray,
    viewmat: np.ndarray,
    K: np.ndarray,
    iterations: int = ITERATIONS,
    update: Callable[[int, float], None] = lambda done, psnr: None,
) -> Gaussians:
    """The Gaussians with the colours that show `picture` [H, W, 3] best: min |A x − b|² + RIDGE · Σ d (x − x₀)², x ≥ 0.

    x₀ are the colours given, d = Aᵀ1 the blending weights in pixels, which also precondition. Conjugate gradients, two
    thirds of `iterations` freely; then what became negative stays at 0, where the rasteriser would clamp it, and the
    rest goes on. update: called after each iteration with its number and the PSNR in dB (of the colours unclamped).
    """
    device = gaussians.means.device
    target, pose, intrinsics = (
        torch.as_tensor(a, dtype=torch.float32, device=device) for a in (picture, viewmat, K)
    )
    blending = _Blending(gaussians, pose, intrinsics, (picture.shape[1], picture.shape[0]))
    start = torch.clamp_min(0.5 + SH_C0 * gaussians.sh[:, 0], 0.0)
    behind = blending.picture(start)[1]
    _, weights = blending.with_adjoint(start, torch.ones_like(target))
    weights = weights.clamp_min(1e-6)
    colours, done = start, 0
    for count in (iterations - iterations // 3, iterations // 3):
        free = ((colours > 0) | (done == 0)).float()
        residual = target - behind - blending.picture(colours)[0]
        colours = _gradients(
            blending, colours, start, residual, weights, free, (done, count), update
        ).clamp_min(0.0)
        done += count
    return replace(gaussians, sh=_sh(colours))


def _gradients(
    blending: _Blending,
    colours: Tensor,  # [N, 3]
    start: Tensor,  # [N, 3] what the ridge holds to
    residual: Tensor,  # [H, W, 3] of `colours`
    weights: Tensor,  # [N, 3]
    free: Tensor,  # [N, 3] 1, or 0 where a colour must stay
    steps: tuple[int, int],  # iterations before and now
    update: Callable[[int, float], None],
) -> Tensor:
    """Preconditioned conjugate gradients, the three channels each with steps of their own."""
    _, right = blending.with_adjoint(colours, residual)
    gradient = free * (right - RIDGE * weights * (colours - start))
    direction = gradient / weights
    size = (gradient * direction).sum(0)
    for i in range(steps[1]):
        image, product = blending.with_adjoint(direction)
        product = free * (product + RIDGE * weights * direction)
        step = size / (direction * product).sum(0).clamp_min(1e-30)
        colours, residual = colours + step * direction, residual - step * image
        gradient = gradient - step * product
        before, size = size, (gradient**2 / weights).sum(0)
        direction = gradient / weights + size / before.clamp_min(1e-30) * direction
        update(steps[0] + i + 1, _psnr(residual))
    return colours


def _psnr(difference: Tensor) -> float:
    return float(-10 * torch.log10((difference**2).mean().clamp_min(1e-10)))


def fit_plane(views: RestViews, config: SpaceConfig | None = None, device: str = "cpu") -> SpaceFit:
    """Gaussians on a plane before the one camera of a flat capture.

    Of the settings, `max_gaussians` counts (0: one for nine pixels, at most `MOST`) and `iterations` (0: `ITERATIONS`,
    of conjugate gradients). It takes seconds, so there is no checkpoint. Raises CaptureError where there is not exactly
    one camera, Tg4mmError on settings out of range.
    """
    config = checked(config or SpaceConfig())
    if len(views.rgb) != 1:
        raise CaptureError(f"a flat capture has one fixed camera, this one has {len(views.rgb)}")
    reset_gpu_peak(device)
    began = time.monotonic()
    picture, K, viewmat = _without_holes(views.rgb[0]), views.Ks[0], views.viewmats[0]
    width, height = views.size
    budget = config.max_gaussians or min(max(width * height // PIXELS_PER_GAUSSIAN, FEWEST), MOST)
    iterations = config.iterations or ITERATIONS
    gaussians = plane_gaussians(picture, K, viewmat, budget).to(device)
    with progress("space stage", iterations) as update, full_precision(device):
        gaussians = solve_colours(
            gaussians,
            picture,
            viewmat,
            K,
            iterations,
            lambda done, psnr: update(done, psnr_db=round(psnr, 2)),
        )
    psnr = plane_psnr(gaussians, picture, viewmat, K)
    gaussians = gaussians.detach().to("cpu")
    figures = {
        "init": "plane",
        "seconds": time.monotonic() - began,
        "peak_memory_mib": peak_memory_mib(),
        **gpu_figures(device),
        "n_gaussians": len(gaussians),
        "iterations": iterations,
        "psnr_train": psnr,
    }
    return SpaceFit(gaussians, figures)


def _without_holes(picture: np.ndarray) -> np.ndarray:
    """Return [H, W, 3]: with the nearest pixel where a mask left nothing."""
    is_masked = np.isnan(picture[..., 0])
    if not is_masked.any():
        return picture
    nearest = distance_transform_edt(is_masked, return_distances=False, return_indices=True)
    return np.asarray(picture[tuple(nearest)])


@torch.no_grad()
def plane_psnr(gaussians: Gaussians, picture: np.ndarray, viewmat: np.ndarray, K: np.ndarray) -> float:
    """PSNR, dB, of what the Gaussians show over white against `picture` [H, W, 3]."""
    target, pose, intrinsics = (
        torch.as_tensor(a, dtype=torch.float32, device=gaussians.means.device) for a in (picture, viewmat, K)
    )
    size = picture.shape[1], picture.shape[0]
    shown = render_view(gaussians, pose, intrinsics, size, gaussians.sh_degree).rgb.clamp(0, 1)
    return _psnr(shown - target)
