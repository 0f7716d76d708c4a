"""Scenes for the rasteriser's tests, and the comparison of its values and gradients with the dense twin's.

The kernels compute in float32, the twin in float64 from the same (float32) numbers. Errors are measured
against the largest entry of the tensor they are in: a gradient is a sum over pixels of terms of either sign,
so rounding is relative to the terms, not to what is left of them. Typical errors are 1e-7 to 2e-5;
`TOLERANCE` is five times that.

Blending has thresholds (alpha at 1/255 and 0.999, transmittance at 1e-4). Where the twin stands so close to
one that float32 may fall on the other side, the pixel gets no say: its value is not compared and its weight
in the loss is zero. `check` insists that such pixels are few.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from tests.helpers.dense import project, rasterize_dense
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, ALPHA_MIN, T_MIN

TOLERANCE = 1e-4
NAMES = ("means", "quats", "scales", "opacities", "colors")


@dataclass(frozen=True)
class Scene:
    """Gaussians and cameras, float64 tensors whose values are float32's. Shapes as in `rasterization`."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor  # SH [N, 16, 3]; tests of plain channels replace it
    viewmats: Tensor
    Ks: Tensor
    width: int
    height: int

    def tensors(self, dtype=torch.float64, device="cpu"):
        """Fresh leaves of everything that gets a gradient, in the order of NAMES."""
        source = (self.means, self.quats, self.scales, self.opacities, self.colors)
        return [a.detach().clone().to(device, dtype).requires_grad_() for a in source]


def uniform(rng, *shape, low=0.0, high=1.0):
    return low + (high - low) * torch.rand(*shape, generator=rng, dtype=torch.float64)


def random_rotations(rng, n):
    """Proper rotation matrices [n, 3, 3]."""
    q, r = torch.linalg.qr(torch.randn(n, 3, 3, generator=rng, dtype=torch.float64))
    q = q * torch.sign(torch.diagonal(r, dim1=1, dim2=2))[:, None]
    return q * torch.linalg.det(q)[:, None, None]


def make_scene(
    seed=0, n=40, size=(50, 37), scale=(0.03, 0.3), opacity=(0.05, 0.95), spread=1.0, distance=4.0, cameras=1
):
    """n Gaussians in a cube of half side `spread`, cameras at `distance` from its centre, turned at random
    and a little aside.

    fx and fy differ, the principal point is off centre and quaternions have lengths from 0.1 to 10. `scale`
    is the range of standard deviations, drawn log-uniformly for each axis.
    """
    rng = torch.Generator().manual_seed(seed)
    width, height = size
    low, high = torch.tensor(scale, dtype=torch.float64).log().tolist()
    quats = torch.nn.functional.normalize(torch.randn(n, 4, generator=rng, dtype=torch.float64), dim=-1)
    viewmats = torch.eye(4, dtype=torch.float64).repeat(cameras, 1, 1)
    viewmats[:, :3, :3] = random_rotations(rng, cameras)
    viewmats[:, :2, 3] = uniform(rng, cameras, 2, low=-0.3, high=0.3)
    viewmats[:, 2, 3] = distance
    Ks = torch.eye(3, dtype=torch.float64).repeat(cameras, 1, 1)
    largest = max(size)
    Ks[:, 0, 0] = uniform(rng, cameras, low=1.1, high=1.5) * largest
    Ks[:, 1, 1] = uniform(rng, cameras, low=0.9, high=1.3) * largest
    Ks[:, 0, 2] = uniform(rng, cameras, low=0.35, high=0.65) * width
    Ks[:, 1, 2] = uniform(rng, cameras, low=0.35, high=0.65) * height
    tensors = {
        "means": uniform(rng, n, 3, low=-spread, high=spread),
        "quats": quats * torch.exp(uniform(rng, n, 1, low=-2.3, high=2.3)),
        "scales": torch.exp(uniform(rng, n, 3, low=low, high=high)),
        "opacities": uniform(rng, n, low=opacity[0], high=opacity[1]),
        "colors": uniform(rng, n, 16, 3, low=-0.3, high=0.5),
        "viewmats": viewmats,
        "Ks": Ks,
    }
    return Scene(**{k: v.float().double() for k, v in tensors.items()}, width=width, height=height)


def with_channels(scene, channels, seed=0):
    """The scene with plain channels [N, channels] in place of spherical harmonics."""
    rng = torch.Generator().manual_seed(seed + 99)
    colors = uniform(rng, len(scene.means), channels, low=-1.0, high=2.0).float().double()
    return replace(scene, colors=colors)


def render(tensors, scene, sh_degree=None, **options):
    """`rasterization` of tensors in the order of NAMES, from the scene's cameras."""
    cameras = scene.viewmats.to(tensors[0]), scene.Ks.to(tensors[0])
    return rasterization(*tensors, *cameras, scene.width, scene.height, sh_degree=sh_degree, **options)


def twin(tensors, scene, sh_degree, backgrounds):
    """`rasterization` by the dense twin: renders [C, H, W, D] and alphas [C, H, W, 1]."""
    means, quats, scales, opacities, colors = tensors
    features = colors if sh_degree is None else colors[:, : (sh_degree + 1) ** 2]
    renders, alphas = [], []
    for c, viewmat in enumerate(scene.viewmats.to(means)):
        image, alpha = rasterize_dense(
            means, quats, scales, opacities, features, viewmat, scene.Ks[c].to(means), scene.width,
            scene.height, use_sh=sh_degree is not None,
        )  # fmt: skip
        alphas.append(alpha[..., None])
        renders.append(image if backgrounds is None else image + (1 - alphas[-1]) * backgrounds[c])
    return torch.stack(renders), torch.stack(alphas)


@dataclass(frozen=True)
class Thresholds:
    """What one view's blending does at its thresholds, from the twin's geometry in float64."""

    safe: Tensor  # [H, W] bool: float32 decides as float64 does
    largest: float  # alpha before it is limited to ALPHA_MAX
    n_stopped: int  # pixels that stop before the last Gaussian
    n_clamped: int  # visible Gaussians whose Jacobian is taken at the limit of the field of view
    aspect: float  # largest ratio of the axes of an ellipse


def thresholds(scene, c=0, margin=1e-4):
    """Thresholds of camera c. `margin` is the relative distance of an alpha that counts as safe."""
    w, h, viewmat, K = scene.width, scene.height, scene.viewmats[c], scene.Ks[c]
    uv, cov, depth = project(scene.means, scene.quats, scene.scales, viewmat, K, w, h, 0.3)
    order = torch.argsort(depth)
    order = order[depth[order] > 0.01]
    gaps = torch.diff(depth[order]) / depth[order][1:]
    assert (gaps > 5e-7).all(), "two depths that float32 cannot order: take another seed"
    uv, cov = uv[order], cov[order]
    ys, xs = torch.meshgrid(torch.arange(h) + 0.5, torch.arange(w) + 0.5, indexing="ij")
    d = torch.stack([xs.ravel(), ys.ravel()], -1).double() - uv[:, None]
    raw = scene.opacities[order, None] * torch.exp(
        -0.5 * torch.einsum("npi,nij,npj->np", d, torch.linalg.inv(cov), d)
    )
    alpha = torch.where(raw >= ALPHA_MIN, raw.clamp_max(ALPHA_MAX), 0.0)
    transmittance = torch.cumprod(1 - alpha, 0)
    close = ((raw / ALPHA_MIN - 1).abs() < margin) | ((raw / ALPHA_MAX - 1).abs() < margin)
    # a transmittance is a product of many rounded factors, each 1 - alpha down to 0.001
    close |= (transmittance / T_MIN - 1).abs() < 10 * margin
    cam = scene.means[order] @ viewmat[:3, :3].T + viewmat[:3, 3]
    x, y = cam[:, 0] / cam[:, 2], cam[:, 1] / cam[:, 2]
    u_limit, v_limit = 0.15 * w, 0.15 * h
    u, v = x * K[0, 0] + K[0, 2], y * K[1, 1] + K[1, 2]
    outside = (u < -u_limit) | (u > w + u_limit) | (v < -v_limit) | (v > h + v_limit)
    eigenvalues = torch.linalg.eigvalsh(cov)
    return Thresholds(
        safe=~close.any(0).reshape(h, w) if len(order) else torch.ones(h, w, dtype=torch.bool),
        largest=raw.max().item() if len(order) else 0.0,
        n_stopped=int((transmittance <= T_MIN).any(0).sum()),
        n_clamped=int((outside & (alpha > 0).any(1)).sum()),
        aspect=(eigenvalues[:, 1] / eigenvalues[:, 0]).max().sqrt().item() if len(order) else 1.0,
    )


def assert_close(name, actual, expected, tolerance):
    """Every entry within `tolerance` times the largest entry expected; nothing may be NaN or misshapen."""
    assert actual.shape == expected.shape, f"{name}: shape {tuple(actual.shape)}, not {tuple(expected.shape)}"
    if expected.numel() == 0:
        return
    actual, expected = actual.detach().cpu().double(), expected.detach().double()
    error = (actual - expected).abs().max().item()
    scale = expected.abs().max().item()
    assert error <= tolerance * scale + 1e-12, f"{name}: error {error:.3g}, largest entry {scale:.3g}"


def assert_gradients_close(actual, expected, tolerance):
    """Gradients of the tensors NAMES. None stands for zero: what the loss does not depend on at all."""
    for name, a, e in zip(NAMES, actual, expected, strict=True):
        found = torch.zeros_like(a) if a.grad is None else a.grad
        wanted = torch.zeros_like(e) if e.grad is None else e.grad
        assert_close(f"gradient by {name}", found, wanted, tolerance)


def check(
    scene,
    sh_degree=3,
    backgrounds=None,  # [C, D] float64
    tolerance=TOLERANCE,
    margin=1e-4,
    device="cpu",
):
    """Compare `rasterization` with the twin: images, alphas and the gradients of a random loss on both."""
    exact, ours = scene.tensors(), scene.tensors(torch.float32, device)
    fill = fill32 = None
    if backgrounds is not None:
        fill, fill32 = backgrounds.clone().requires_grad_(), backgrounds.to(device).float().requires_grad_()
    e_image, e_alpha = twin(exact, scene, sh_degree, fill)
    a_image, a_alpha, _ = render(ours, scene, sh_degree, backgrounds=fill32)
    safe = torch.stack([thresholds(scene, c, margin).safe for c in range(len(scene.viewmats))])[..., None]
    assert safe.double().mean() >= 0.95 or safe.numel() < 100, "too many pixels at a threshold: another seed"
    assert_close("image", a_image.cpu() * safe, e_image * safe, tolerance)
    assert_close("alpha", a_alpha.cpu() * safe, e_alpha * safe, tolerance)
    rng = torch.Generator().manual_seed(7)
    w_image = torch.randn(e_image.shape, generator=rng, dtype=torch.float64) * safe
    w_alpha = torch.randn(e_alpha.shape, generator=rng, dtype=torch.float64) * safe
    for image, alpha in ((e_image, e_alpha), (a_image, a_alpha)):
        loss = (image * w_image.to(image)).sum() + (alpha * w_alpha.to(alpha)).sum()
        loss.backward()
    assert_gradients_close(ours, exact, tolerance)
    if fill is not None and fill.grad is not None:
        assert fill32.grad is not None
        assert_close("gradient by backgrounds", fill32.grad, fill.grad, tolerance)
