"""Gaussians at time t with their motion magnified by α: what is rendered, measured and exported."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion, apply_appearance, fields_of

Alpha = float | np.ndarray  # one for all modes, or [K]: one each, as `Magnification.ideal` gives them


def mode_gains(motion: ModalMotion, t: float, alpha: Alpha) -> np.ndarray:
    """Return [K] complex factors (1 + α_k) exp(i 2π f_k t / fps).

    Time courses of the motion replace the exponentials where it has them; modes that are never magnified have α_k = 0.
    """
    return np.asarray((1 + alpha * motion.is_magnified()) * motion.gains_at(t))


def _sum(phasors: np.ndarray, gains: np.ndarray) -> np.ndarray:
    k, n = phasors.shape[:2]
    return np.ascontiguousarray((gains.astype(np.complex64) @ phasors.reshape(k, 3 * n)).real).reshape(n, 3)


def displacement_at(motion: ModalMotion, t: float, alpha: Alpha = 0.0) -> np.ndarray:
    """Return [N, 3] displacement from rest in scene units at timestep t (sub-frames allowed)."""
    return _sum(motion.displacement, mode_gains(motion, t, alpha))


def rotation_at(motion: ModalMotion, t: float, alpha: Alpha = 0.0) -> np.ndarray:
    """Return [N, 3] rotation vectors from rest in radians, world axes, at timestep t."""
    return _sum(motion.rotation, mode_gains(motion, t, alpha))


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
    if motion is None:
        return gaussians
    _check_number(gaussians, motion)
    gains = mode_gains(motion, t, alpha)
    change = np.concatenate([_sum(motion.displacement, gains), _sum(motion.rotation, gains)], 1)
    there = moved(gaussians, torch.from_numpy(change).to(gaussians.means))
    return _with_appearance(there, motion, gains, _appearance_on(gaussians.means.device, motion))


def _check_number(gaussians: Gaussians, motion: ModalMotion) -> None:
    if (n := motion.displacement.shape[1]) != len(gaussians):
        raise ValueError(f"the motion has {n} Gaussians, the scene {len(gaussians)}")


def _with_appearance(
    gaussians: Gaussians, motion: ModalMotion, gains: np.ndarray, fields: Tensor | None
) -> Gaussians:
    """Add the appearance whose `fields` are on the Gaussians' device."""
    if motion.appearance is None or fields is None:
        return gaussians
    coefficients = torch.from_numpy(motion.appearance.coefficients(gains)).to(gaussians.sh)
    return replace(gaussians, sh=apply_appearance(gaussians.sh, fields, coefficients))


def _appearance_on(device: torch.device, motion: ModalMotion) -> Tensor | None:
    return None if motion.appearance is None else torch.from_numpy(motion.appearance.shapes).to(device)


def animator(gaussians: Gaussians, motion: ModalMotion | None) -> Callable[..., Gaussians]:
    """Return `animate` with this motion as a function of (t, alpha), for many timesteps.

    It keeps the few fields of which the phasors of all frequencies are sums, and on a GPU sends them once: many times
    as fast for many frequencies.
    Raises ValueError if the motion has another number of Gaussians.
    """
    device = gaussians.means.device
    if motion is None:
        return partial(animate, gaussians, motion)
    _check_number(gaussians, motion)
    fields, series = fields_on(device, motion)
    appearance = _appearance_on(device, motion)

    def animated(t: float, alpha: Alpha = 0.0) -> Gaussians:
        gains = mode_gains(motion, t, alpha)
        factors = torch.from_numpy((gains @ series).real.astype(np.float32)).to(device)
        there = moved(gaussians, (factors @ fields).reshape(-1, 6))
        return _with_appearance(there, motion, gains, appearance)

    return animated


def fields_on(device: torch.device, motion: ModalMotion) -> tuple[Tensor, np.ndarray]:
    """Return fields [R, 6 N] and series [K, R] whose product is the motion's phasors, to rounding."""
    fields, series = fields_of(motion)
    return torch.from_numpy(fields.reshape(len(fields), 6 * fields.shape[1])).to(device), series
