"""The decoded motion of a `paper` run as modes: positions and rotations over time, by the discrete Fourier transform.

Lost in it: what the decoder changes in scale, opacity and colour over time. Kept: every timestep's position and
rotation, exactly. The mean offset from timestep 0 is a mode of 0 Hz.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from tg4mm.core.phasors import series_modes
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.paper.model import PaperModel


def rotation_between(start: Tensor, end: Tensor) -> Tensor:
    """[N, 3] rotation vectors, radians, world axes, of the turn that takes quaternions [N, 4] `start` to `end`."""
    a, b = (torch.nn.functional.normalize(q.double(), dim=1) for q in (start, end))
    # b ā, of the two signs of a quaternion that with the smaller turn
    w = (a * b).sum(1)
    v = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - torch.linalg.cross(b[:, 1:], a[:, 1:])
    v = torch.where((w < 0)[:, None], -v, v)
    length = torch.linalg.vector_norm(v, dim=1, keepdim=True)
    angle = 2 * torch.atan2(length, w.abs()[:, None])
    return torch.where(length > 1e-12, v / length.clamp_min(1e-12) * angle, 2 * v)


@torch.no_grad()
def modal_of_series(model: PaperModel, planes: Iterable[Tensor], fps: float) -> ModalMotion:
    """The motion from timestep 0 of what the motion planes (values [A, C] of timesteps 1, 2, …) decode to."""
    rest = model.rest()
    changes = [torch.zeros(len(rest), 6, dtype=torch.float64)]
    for values in planes:
        now = model.decode(model.embedding(values))
        shift = now.means.double() - rest.means.double()
        changes.append(torch.cat([shift, rotation_between(rest.quats, now.quats)], 1))
    freqs, phasors = series_modes(torch.stack(changes).numpy(), fps)
    return ModalMotion(freqs, phasors[..., :3], phasors[..., 3:], fps, len(changes))
