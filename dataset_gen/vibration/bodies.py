"""What vibrates: meshes at rest, as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class Body:
    """One object at rest. Raises ValueError if the arrays do not fit together or are not finite."""

    name: str
    vertices: np.ndarray  # [V, 3] float64, world space, scene units
    triangles: np.ndarray  # [F, 3] int
    follow: np.ndarray  # [V] in 0..1: how much of every mode's field a vertex goes along with
    groups: Mapping[str, np.ndarray] = field(default_factory=dict)  # weights [V] of the vertex groups

    def __post_init__(self) -> None:
        n = len(self.vertices)
        shapes = {"vertices": (self.vertices, (n, 3)), "follow": (self.follow, (n,))}
        shapes |= {f"group {name!r}": (weights, (n,)) for name, weights in self.groups.items()}
        for what, (array, shape) in shapes.items():
            if array.shape != shape:
                raise ValueError(f"{self.name}: {what} has shape {array.shape}, expected {shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{self.name}: {what} holds a value that is not finite")
        if self.triangles.ndim != 2 or self.triangles.shape[1] != 3:
            raise ValueError(f"{self.name}: triangles have shape {self.triangles.shape}, expected [F, 3]")
