"""A scene as a readable description: parts, surfaces, lights, world. The renderer is one view of it."""

from dataclasses import dataclass

import numpy as np

from .meshes import Mesh

Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class Surface:
    """A material: painted pattern, relief, and how it reflects. Maps lie in the mesh's texture coordinates."""

    name: str
    colour: np.ndarray  # [H, W, 3] display-referred sRGB in 0..1; row 0 is v = 0
    relief: np.ndarray | None = None  # [H, W] height in 0..1, engraved or raised by `relief_depth`
    relief_depth: float = 0.004  # scene units
    metallic: float = 0.0
    roughness: float | np.ndarray = 0.5  # one number, or a map [H, W]
    coat: float = 0.0  # weight of a clear varnish
    coat_roughness: float = 0.03
    transmission: float = 0.0  # 1: glass or water; light that goes through costs samples
    ior: float = 1.5
    subsurface: float = 0.0  # weight of light scattered under the skin
    subsurface_radius: float = 0.05  # how far it wanders, scene units
    sheen: float = 0.0  # weight of the bright rim of cloth and velvet


@dataclass(frozen=True)
class Part:
    """One object: a mesh in world space at rest, its surface, and how much each vertex follows the modes."""

    name: str
    mesh: Mesh
    surface: Surface
    follow: np.ndarray  # [V] in 0..1; 1 goes along with the field of the mode, 0 is held still


def part(name: str, mesh: Mesh, surface: Surface, follow: np.ndarray | float = 1.0) -> Part:
    """A part that follows the modes wholly, or by as much as `follow` ([V] or a number) says."""
    return Part(name, mesh, surface, np.broadcast_to(np.asarray(follow, float), (len(mesh.vertices),)))


@dataclass(frozen=True)
class AreaLight:
    """A soft box."""

    position: tuple[float, float, float]  # scene units
    size: float  # edge of the square, scene units
    power: float  # watts, as Blender counts them
    colour: Rgb  # linear RGB
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)  # what it looks at


@dataclass(frozen=True)
class Gradient:
    """A world that fades through colours from straight below to straight above."""

    colours: tuple[Rgb, ...]  # linear RGB, evenly spaced


@dataclass(frozen=True)
class BlenderSky:
    """Blender's own physical sky with its sun."""

    sun_elevation: float  # radians
    sun_rotation: float  # radians about z
    strength: float = 0.2
    sun_size: float = 0.05  # radians, larger than the real one: softer shadows, less noise


@dataclass(frozen=True)
class Environment:
    """A generated HDR: an equirectangular picture all around."""

    pixels: np.ndarray  # [H, 2H, 3] linear RGB ≥ 0; row 0 is straight below, column 0 looks along −x
    strength: float = 1.0


@dataclass(frozen=True)
class Scene:
    """The rendered scene. Its vibration is described in `<name>.yaml` beside it."""

    name: str
    parts: tuple[Part, ...]
    lights: tuple[AreaLight, ...]
    sky: Gradient | BlenderSky | Environment
    unit_scale_m: float | None = None  # metres per scene unit, None if the scene has no true size
