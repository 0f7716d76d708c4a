"""A scene as a readable description: parts, surfaces, lights, modes. The renderer is one view of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .meshes import Mesh
from .vibration import Mode, Motion, mode_shapes


@dataclass(frozen=True)
class Surface:
    """A material: painted pattern, relief, and how it reflects."""

    name: str
    colour: np.ndarray  # [H, W, 3] display-referred sRGB in 0..1; row 0 is v = 0
    relief: np.ndarray | None = None  # [H, W] height in 0..1, engraved or raised by `relief_depth`
    relief_depth: float = 0.004  # scene units
    metallic: float = 0.0
    roughness: float = 0.5


@dataclass(frozen=True)
class Part:
    """One object: a mesh in world space at rest, its surface, and how much each vertex follows the modes."""

    name: str
    mesh: Mesh
    surface: Surface
    follow: np.ndarray  # [V] in 0..1; 1 goes along with the field of the mode, 0 is held still


@dataclass(frozen=True)
class AreaLight:
    """A soft box that looks at the origin."""

    position: tuple[float, float, float]  # scene units
    size: float  # edge of the square, scene units
    power: float  # watts, as Blender counts them
    colour: tuple[float, float, float]  # linear RGB


@dataclass(frozen=True)
class Scene:
    """What is rendered, and how it vibrates."""

    name: str
    parts: tuple[Part, ...]
    lights: tuple[AreaLight, ...]
    modes: tuple[Mode, ...]
    sky: tuple[
        tuple[float, float, float], ...
    ]  # linear RGB of the world from straight below to straight above
    unit_scale_m: float | None = None  # metres per scene unit, None if the scene has no true size

    def shapes(self) -> list[np.ndarray]:
        """Complex mode shapes per part, [K, V, 3], scene units."""
        return mode_shapes(self.modes, [(part.mesh.vertices, part.follow) for part in self.parts])

    def motion(self, fps: float) -> Motion:
        """The motion of all parts at a frame rate."""
        return Motion(self.shapes(), [mode.frequency_hz for mode in self.modes], fps)
