"""Gaussians at time t with their motion magnified by α: what is rendered, measured and exported."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion, apply_appearance

Alpha = float | np.ndarray  # one for all modes, or [K]: one each, as `Magnification.ideal` gives them


def mode_gains(motion: ModalMotion, t: float, alpha: Alpha) -> np.ndarray:
    """Return [K] complex factors (1 + α_k) exp(i 2π f_k t / fps).

    Time courses of the motion replace the exponentials where it has them; modes that are never magnified have α_k = 0.
    """
    return np.asarray((1 + alpha * motion.is_magnified()) * motion.gains_at(t))


def _at(motion: ModalMotion, t: float, alpha: Alpha, columns: slice) -> np.ndarray:
    factors = motion.coefficients(mode_gains(motion, t, alpha))
    return np.asarray(np.tensordot(factors, motion.fields[..., columns], axes=1), np.float32)


def displacement_at(motion: ModalMotion, t: float, alpha: Alpha = 0.0) -> np.ndarray:
    """Return [N, 3] displacement from rest in scene units at timestep t (sub-frames allowed)."""
    return _at(motion, t, alpha, slice(0, 3))


def rotation_at(motion: ModalMotion, t: float, alpha: Alpha = 0.0) -> np.ndarray:
    """Return [N, 3] rotation vectors from rest in radians, world axes, at timestep t."""
    return _at(motion, t, alpha, slice(3, 6))


def rotated(quats: Tensor, rotation: Tensor) -> Tensor:
    """Quaternions [N, 4] (wxyz) rotated by rotation vectors [N, 3] about the world axes."""
    angle = torch.linalg.vector_norm(rotation, dim=-1, keepdim=True)
    half = angle / 2
    # sin(x)/x by torch.sinc, smooth at zero
    w, v = torch.cos(half), rotation * (torch.sinc(half / torch.pi) / 2)
    a, b = quats[:, :1], quats[:, 1:]
    return torch.cat([w * a - (v * b).sum(-1, keepdim=True), w * b + a * v + torch.linalg.cross(v, b)], -1)


def moved(gaussians: Gaussians, motion: Tensor) -> Gaussians:
    """The Gaussians displaced and rotated by `motion` [N, 6]: scene units, and rotation vectors in radians."""
    means, quats = gaussians.means + motion[:, :3], rotated(gaussians.quats, motion[:, 3:])
    return replace(gaussians, means=means, quats=quats)


def animate(gaussians: Gaussians, motion: ModalMotion | None, t: float, alpha: Alpha = 0.0) -> Gaussians:
    """Return the Gaussians at timestep t, motion and appearance magnified by 1 + α. Without motion: at rest.

    Raises ValueError if the motion has another number of Gaussians.
    """
    return animator(gaussians, motion)(t, alpha)


def animator(gaussians: Gaussians, motion: ModalMotion | None) -> Callable[..., Gaussians]:
    """Return `animate` with this motion as a function of (t, alpha), for many timesteps: a GPU gets the fields once.

    Raises ValueError if the motion has another number of Gaussians.
    """
    if motion is None:
        return lambda t, alpha=0.0: gaussians
    if (n := motion.n_gaussians) != len(gaussians):
        raise ValueError(f"the motion has {n} Gaussians, the scene {len(gaussians)}")
    device, light = gaussians.means.device, motion.appearance
    fields = torch.from_numpy(motion.fields.reshape(len(motion.fields), 6 * n)).to(device)
    shapes = None if light is None else torch.from_numpy(light.shapes).to(device)

    def animated(t: float, alpha: Alpha = 0.0) -> Gaussians:
        gains = mode_gains(motion, t, alpha)
        change = (_on(device, motion.coefficients(gains)) @ fields).reshape(-1, 6)
        there = moved(gaussians, change.to(gaussians.means))
        if light is None or shapes is None:
            return there
        return replace(there, sh=apply_appearance(there.sh, shapes, _on(device, light.coefficients(gains))))

    return animated


def _on(device: torch.device, factors: np.ndarray) -> Tensor:
    return torch.from_numpy(factors).to(device)
