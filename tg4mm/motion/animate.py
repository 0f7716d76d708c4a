"""Gaussians at time t with their motion magnified by α: what is rendered, measured and exported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from tg4mm.gaussians import Gaussians
from tg4mm.motion.modes import ModalMotion, apply_appearance

Alpha = float | np.ndarray  # one for all modes, or [K]: one each


def mode_gains(motion: ModalMotion, t: float, alpha: Alpha, band: tuple[float, float] | None) -> np.ndarray:
    """[K] complex factors (1 + α g_k) exp(i 2π f_k t / fps); g_k = 1 for f_k in `band` (ends included), else 0.

    band None takes every mode in; with an α for each mode ([K]) that is how several bands are magnified at once.
    Gains of the motion's own stand for the exponentials, and modes that are not magnified have g_k = 0.
    """
    freqs = motion.freqs_hz
    inside = motion.is_magnified()
    if band is not None:
        inside = inside & (freqs >= band[0]) & (freqs <= band[1])
    return np.asarray((1 + alpha * inside) * motion.gains_at(t))


def _sum(phasors: np.ndarray, gains: np.ndarray) -> np.ndarray:
    return np.einsum("knc,k->nc", phasors.real, gains.real) - np.einsum("knc,k->nc", phasors.imag, gains.imag)


def displacement_at(
    motion: ModalMotion, t: float, alpha: Alpha = 0.0, band: tuple[float, float] | None = None
) -> np.ndarray:
    """[N, 3] displacement from rest in scene units at timestep t (sub-frames allowed)."""
    return _sum(motion.displacement, mode_gains(motion, t, alpha, band))


def rotation_at(
    motion: ModalMotion, t: float, alpha: Alpha = 0.0, band: tuple[float, float] | None = None
) -> np.ndarray:
    """[N, 3] rotation vectors from rest in radians, world axes, at timestep t."""
    return _sum(motion.rotation, mode_gains(motion, t, alpha, band))


def rotated(quats: Tensor, rotation: Tensor) -> Tensor:
    """Quaternions [N, 4] (wxyz) rotated by rotation vectors [N, 3] about the world axes."""
    angle = torch.linalg.vector_norm(rotation, dim=-1, keepdim=True)
    half = angle / 2
    # sin(x)/x by torch.sinc, smooth at zero
    w, v = torch.cos(half), rotation * (torch.sinc(half / torch.pi) / 2)
    a, b = quats[:, :1], quats[:, 1:]
    return torch.cat([w * a - (v * b).sum(-1, keepdim=True), w * b + a * v + torch.linalg.cross(v, b)], -1)


def animate(
    gaussians: Gaussians,
    motion: ModalMotion | None,
    t: float,
    alpha: Alpha = 0.0,
    band: tuple[float, float] | None = None,
) -> Gaussians:
    """The Gaussians at timestep t, motion and appearance inside the band magnified by 1 + α. None: at rest.

    Raises ValueError if the motion is of another number of Gaussians.
    """
    if motion is None:
        return gaussians
    n = motion.displacement.shape[1]
    if n != len(gaussians):
        raise ValueError(f"the motion has {n} Gaussians, the scene {len(gaussians)}")
    like = gaussians.means
    shift = torch.from_numpy(displacement_at(motion, t, alpha, band)).to(like)
    rotation = torch.from_numpy(rotation_at(motion, t, alpha, band)).to(like)
    sh = gaussians.sh
    if motion.appearance is not None:
        coefficients = motion.appearance.coefficients(mode_gains(motion, t, alpha, band))
        sh = apply_appearance(
            sh, torch.from_numpy(motion.appearance.shapes).to(sh), torch.from_numpy(coefficients).to(sh)
        )
    return replace(gaussians, means=like + shift, quats=rotated(gaussians.quats, rotation), sh=sh)


def animator(
    gaussians: Gaussians, motion: ModalMotion | None, packed: bool = False
) -> Callable[..., Gaussians]:
    """`animate` with this motion as a function of (t, alpha, band), for many timesteps.

    Off the CPU the phasors go to the Gaussians' device once (K · N · 48 bytes, and the fields of appearance), per
    timestep only the gains. With `packed`, which is for looking, the CPU holds the few fields that the phasors of all
    frequencies are sums of, to 10⁻⁵ of the strongest: many times as fast where there are many frequencies.
    Raises ValueError if the motion is of another number of Gaussians.
    """
    device = gaussians.means.device
    if motion is None or (device.type == "cpu" and not packed):
        return partial(animate, gaussians, motion)
    if motion.displacement.shape[1] != len(gaussians):
        raise ValueError(
            f"the motion has {motion.displacement.shape[1]} Gaussians, the scene {len(gaussians)}"
        )
    shapes = None if motion.appearance is None else torch.from_numpy(motion.appearance.shapes).to(device)
    phasors, mixing = _phasors_on(device, motion), None
    if packed and len(phasors):
        mixing, phasors = _few_fields(phasors, len(gaussians))
    return partial(_animate_on_device, gaussians, motion, phasors, appearance_fields=shapes, mixing=mixing)


def _phasors_on(device: torch.device, motion: ModalMotion) -> Tensor:
    """[2K, 6N] float32: real parts, then negated imaginary parts, of displacement and rotation."""
    both = np.concatenate([motion.displacement, motion.rotation], 2)
    both = both.reshape(len(both), 6 * both.shape[1])
    return torch.from_numpy(np.concatenate([both.real, -both.imag]).astype(np.float32)).to(device)


def _few_fields(phasors: Tensor, n: int) -> tuple[Tensor, Tensor]:
    """[2K, R] mixing and [R, 6N] fields whose product is `phasors` [2K, 6N] to 10⁻⁵ of the strongest field.

    A capture's frequencies are told from few functions of time, so that R is much smaller than 2K. Displacement and
    rotation count alike, whatever their units.
    """
    gram = torch.zeros(2, len(phasors), len(phasors), dtype=torch.float64, device=phasors.device)
    for some in phasors.reshape(-1, n, 2, 3).split(20_000, dim=1):  # a copy of all in double would be large
        rows = some.double().permute(2, 0, 1, 3).flatten(2)
        gram += rows @ rows.mT
    even = (gram / gram.diagonal(dim1=1, dim2=2).sum(1).clamp_min(1e-300)[:, None, None]).sum(0)
    powers, vectors = torch.linalg.eigh(even)
    mixing = vectors[:, powers > 1e-10 * powers.max()].to(phasors)
    return mixing, mixing.T @ phasors


def _animate_on_device(
    gaussians: Gaussians,
    motion: ModalMotion,
    phasors: Tensor,
    t: float,
    alpha: Alpha = 0.0,
    band: tuple[float, float] | None = None,
    appearance_fields: Tensor | None = None,
    mixing: Tensor | None = None,
) -> Gaussians:
    gains = mode_gains(motion, t, alpha, band)
    factors = torch.from_numpy(np.concatenate([gains.real, gains.imag]).astype(np.float32)).to(phasors.device)
    change = ((factors if mixing is None else factors @ mixing) @ phasors).reshape(-1, 6)
    means, quats = gaussians.means + change[:, :3], rotated(gaussians.quats, change[:, 3:])
    sh = gaussians.sh
    if motion.appearance is not None and appearance_fields is not None:
        sh = apply_appearance(
            sh, appearance_fields, torch.from_numpy(motion.appearance.coefficients(gains)).to(sh)
        )
    return replace(gaussians, means=means, quats=quats, sh=sh)
