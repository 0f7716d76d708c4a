"""The static Gaussians of a scene, in memory. Conventions: docs/conventions.md (gsplat's)."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor


@dataclass(frozen=True)
class Gaussians:
    """N anisotropic Gaussians with spherical-harmonic colour, activated values (not logits, not logs)."""

    means: Tensor  # [N, 3] float32, scene units
    quats: Tensor  # [N, 4] wxyz, normalised where used
    scales: Tensor  # [N, 3] linear, scene units
    opacities: Tensor  # [N] in 0..1
    sh: Tensor  # [N, K, 3], K = (degree + 1)², display-referred sRGB = 0.5 + Σ sh·Y, clamped below at 0

    def __post_init__(self) -> None:
        n = self.means.shape[0]
        expected = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
        for name, shape in expected.items():
            actual = tuple(getattr(self, name).shape)
            if actual != shape:
                raise ValueError(f"{name} has shape {actual}, expected {shape}")
        if (
            self.sh.ndim != 3
            or self.sh.shape[0] != n
            or self.sh.shape[1:] not in {(1, 3), (4, 3), (9, 3), (16, 3)}
        ):
            raise ValueError(f"sh has shape {tuple(self.sh.shape)}, expected ({n}, 1 | 4 | 9 | 16, 3)")

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 … 3."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]

    def to(self, device: str | torch.device) -> "Gaussians":
        """The same on another device."""
        return Gaussians(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})

    def detach(self) -> "Gaussians":
        """The same without gradients."""
        return Gaussians(**{f.name: getattr(self, f.name).detach() for f in fields(self)})


def rotation_matrices(quats: Tensor) -> Tensor:
    """Rotation matrices [N, 3, 3] of quaternions [N, 4] (wxyz, any non-zero length)."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).reshape(*quats.shape[:-1], 3, 3)
