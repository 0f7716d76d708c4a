"""The dense twin of the rasteriser, its oracle: plain differentiable torch, every Gaussian on every pixel.

Same definitions as the CPU kernels and gsplat; meant for float64 and a few dozen Gaussians.
"""

import torch
from torch import Tensor

from tg4mm.fit.gaussians import rotation_matrices
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, ALPHA_MIN, T_MIN


def sh_colours(sh: Tensor, directions: Tensor) -> Tensor:
    """Colours [N, 3] of SH coefficients [N, K, 3] along directions [N, 3]: 0.5 + Σ sh·Y, clamped at 0."""
    x, y, z = torch.nn.functional.normalize(directions, dim=-1).unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    values = [
        0.28209479177387814 * torch.ones_like(x),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    basis = torch.stack(values[: sh.shape[1]], -1)
    return (0.5 + torch.einsum("nk,nkc->nc", basis, sh)).clamp_min(0)


def project(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    eps2d: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """Image means [N, 2] and covariances [N, 2, 2] in pixels, and depths [N], of EWA splatting."""
    R, t = viewmat[:3, :3], viewmat[:3, 3]
    cam = means @ R.T + t
    x, y, z = cam.unbind(-1)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    mx, my = 0.15 * width / fx, 0.15 * height / fy
    tx = torch.clamp(x / z, -cx / fx - mx, (width - cx) / fx + mx)
    ty = torch.clamp(y / z, -cy / fy - my, (height - cy) / fy + my)
    zero = torch.zeros_like(z)
    J = torch.stack([fx / z, zero, -fx / z * tx, zero, fy / z, -fy / z * ty], -1).reshape(-1, 2, 3)
    B = J @ R @ rotation_matrices(quats) * scales[:, None, :]
    cov = B @ B.transpose(1, 2) + eps2d * torch.eye(2, dtype=means.dtype)
    return torch.stack([fx * x / z + cx, fy * y / z + cy], -1), cov, z


def composite(alphas: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
    """[3DGS] Eq. (3), nearest first: alphas [N, P], features [N, D] -> [P, D], transmittance [P].

    A pixel stops at the first Gaussian that would bring its transmittance to T_MIN or below.
    """
    transmittance = torch.cumprod(1 - alphas, 0)
    running = (transmittance > T_MIN).to(alphas.dtype)  # monotone: once stopped, stopped
    before = torch.cat([torch.ones_like(alphas[:1]), transmittance[:-1]])
    weights = before * alphas * running
    last = torch.where(running > 0, transmittance, torch.full_like(transmittance, float("inf"))).amin(0)
    return weights.T @ features, torch.where(torch.isinf(last), torch.ones_like(last), last)


def rasterize_dense(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    features: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    use_sh: bool = True,
) -> tuple[Tensor, Tensor]:
    """One view, [H, W, D] without background, alpha [H, W]. Arguments: `rasterization`."""
    uv, cov, depth = project(means, quats, scales, viewmat, K, width, height, eps2d)
    if use_sh:
        centre = -viewmat[:3, :3].T @ viewmat[:3, 3]
        features = sh_colours(features, means - centre)
    keep = (depth > near_plane) & (depth < far_plane)
    order = torch.argsort(depth[keep], stable=True)
    uv, cov, features, opacity = (a[keep][order] for a in (uv, cov, features, opacities))
    if len(uv) == 0:
        return means.new_zeros(height, width, features.shape[-1]), means.new_zeros(height, width)
    ys, xs = torch.meshgrid(
        torch.arange(height, dtype=means.dtype) + 0.5,
        torch.arange(width, dtype=means.dtype) + 0.5,
        indexing="ij",
    )
    d = torch.stack([xs.ravel(), ys.ravel()], -1)[None] - uv[:, None]  # [N, P, 2]
    sigma = 0.5 * torch.einsum("npi,nij,npj->np", d, torch.linalg.inv(cov), d)
    alpha = (opacity[:, None] * torch.exp(-sigma)).clamp_max(ALPHA_MAX)
    alpha = torch.where(alpha >= ALPHA_MIN, alpha, torch.zeros_like(alpha))
    image, transmittance = composite(alpha, features)
    return image.reshape(height, width, -1), 1 - transmittance.reshape(height, width)
