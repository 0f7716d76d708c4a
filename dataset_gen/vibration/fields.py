"""Displacement fields: rigid motions, twist, soft bodies, vertex groups; the bodies and modes they belong to.

A field maps rest points [V, 3] to displacements [V, 3], real or complex, of any scale: the mode's amplitude
scales it. Fields are frozen dataclasses; their names are the keys of the motion description, and the type of
each says how the key is read (values.py).
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Annotated, Any, ClassVar

import numpy as np

from .values import (
    DampedSinusoid,
    Direction,
    MaybePositive,
    Point,
    Positive,
    Text,
    TimeLaw,
    Triple,
    direction,
    number,
    vector,
    whole,
)

RANDOM = "random"


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


def unit(direction: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return [3] float64 of length 1. The direction must not be zero."""
    d = np.asarray(direction, np.float64)
    d = d / np.abs(d).max()
    return np.asarray(d / np.linalg.norm(d))


def across(direction: Sequence[float] | np.ndarray, axis: np.ndarray, what: str) -> np.ndarray:
    """The unit vector [3] of what `direction` has perpendicular to the unit vector `axis`.

    Raises ValueError, beginning with `what`, if the two are parallel.
    """
    d = unit(direction)
    d = d - axis * (d @ axis)
    if np.linalg.norm(d) < 1e-6:
        raise ValueError(f"{what} {tuple(float(c) for c in direction)} is parallel to it")
    return unit(d)


def plane(
    normal: Sequence[float], x: Sequence[float] | None, what: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (u, v, n) of a plane: n the normal, u along `x` as far as it lies in the plane.

    Without `x`, u is along world x, or along world y if the normal is nearly along x. Raises ValueError,
    beginning with `what`, if x is parallel to the normal.
    """
    n = unit(normal)
    if x is None:
        x = (1.0, 0.0, 0.0) if abs(n[0]) < 0.9 else (0.0, 1.0, 0.0)
    u = across(x, n, what)
    return u, np.cross(n, u), n


def fade(distance: np.ndarray, full: float, zero: float) -> np.ndarray:
    """1 up to the distance `full`, exactly 0 from `zero` on, a smooth step (C¹) in between."""
    u = np.clip((zero - np.asarray(distance, np.float64)) / (zero - full), 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def phasor(degrees: float | np.ndarray) -> np.ndarray:
    """exp(i · degrees), exact at multiples of 90°, so that a real shape stays real."""
    quarters = np.asarray(degrees, np.float64) / 90.0
    whole = np.round(quarters)
    rest = np.exp(0.5j * np.pi * (quarters - whole))
    return np.asarray(np.array([1, 1j, -1, -1j])[whole.astype(int) % 4] * rest)


Shape = Callable[[np.ndarray], np.ndarray]


class Field:
    """A displacement shape: rest points [V, 3] to displacements [V, 3], float64 or complex128."""

    kind: ClassVar[str] = ""

    def __call__(self, points: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def on(self, body: Body, seed: Sequence[int]) -> Shape:
        """The field as one body has it: itself, unless it depends on more than the position.

        `seed`: whole numbers ≥ 0 for what is random.
        """
        return self


def body_seed(name: str) -> int:
    """A whole number that stands for a name, the same in every session."""
    return zlib.crc32(name.encode())


@dataclass(frozen=True)
class Translate(Field):
    """The same displacement everywhere."""

    kind: ClassVar[str] = "translate"
    direction: Direction

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return np.tile(unit(self.direction), (len(points), 1))


@dataclass(frozen=True)
class Drift(Translate):
    """A translation; its mode goes in a ramp instead of a sine."""

    kind: ClassVar[str] = "drift"


@dataclass(frozen=True)
class Rock(Field):
    """A small rigid rotation about an axis through the pivot, linear in the angle: axis × (x − pivot)."""

    kind: ClassVar[str] = "rock"
    pivot: Point
    axis: Direction

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return np.cross(unit(self.axis), points - np.array(self.pivot))


@dataclass(frozen=True)
class Twist(Field):
    """Torsion: sections turn about the axis by an angle that grows in proportion to the way along it.

    0 at and behind the pivot, 1 at `length` along the axis and beyond. Without a length everything turns alike.
    """

    kind: ClassVar[str] = "twist"
    pivot: Point
    axis: Direction
    length: MaybePositive = None

    def __call__(self, points: np.ndarray) -> np.ndarray:
        axis, arm = unit(self.axis), points - np.array(self.pivot)
        turned = np.cross(axis, arm)
        if self.length is None:
            return turned
        return turned * np.clip(arm @ axis / self.length, 0.0, 1.0)[:, None]


def _height_or_point(value: Any) -> float | Triple:
    return vector(value) if isinstance(value, list | tuple) else number(value)


def _direction_or_random(value: Any) -> Triple | str:
    return value if value == "random" else direction(value)


def _seed(value: Any) -> int:
    return whole(value, 0, 2**31 - 1)


@dataclass(frozen=True)
class Jiggle(Field):
    """A soft body that sways: it grows with the distance d from what holds it, as u², then as 2u − 1.

    u = d / reach; the two laws meet at u = 1 with equal slope. `held` is a height z (d is the height above it,
    and what lies lower is held too) or a point (d is the distance from it). With "random" every part sways
    its own way, seeded by its name: level if held at a height, any way if held at a point.
    """

    kind: ClassVar[str] = "jiggle"
    held: Annotated[float | Triple, _height_or_point]
    reach: Positive
    direction: Annotated[Triple | str, _direction_or_random]
    seed: Annotated[int, _seed] = 0

    def profile(self, points: np.ndarray) -> np.ndarray:
        """Return [V], 0 where it is held."""
        if isinstance(self.held, tuple):
            distance = np.linalg.norm(points - np.array(self.held), axis=1)
        else:
            distance = np.maximum(points[:, 2] - self.held, 0.0)
        u = distance / self.reach
        return np.where(u < 1.0, u * u, 2.0 * u - 1.0)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        if isinstance(self.direction, str):
            raise ValueError("a random direction belongs to a part: use on(body, seed)")
        return self.profile(points)[:, None] * unit(self.direction)

    def on(self, body: Body, seed: Sequence[int]) -> Shape:
        if not isinstance(self.direction, str):
            return self
        rng = np.random.default_rng([*seed, self.seed, body_seed(body.name)])
        heading = rng.normal(size=3)
        if not isinstance(self.held, tuple):
            heading = across(heading, np.array([0.0, 0.0, 1.0]), "direction")
        x, y, z = unit(heading).tolist()
        return Jiggle(self.held, self.reach, (x, y, z))


@dataclass(frozen=True)
class Group(Field):
    """The weights of a vertex group times a direction; parts without the group stand still."""

    kind: ClassVar[str] = "group"
    group: Text
    direction: Direction

    def __call__(self, points: np.ndarray) -> np.ndarray:
        raise ValueError("a vertex group belongs to a part: use on(body, seed)")

    def on(self, body: Body, seed: Sequence[int]) -> Shape:
        weights = np.asarray(body.groups.get(self.group, np.zeros(len(body.vertices))), np.float64)
        return lambda points: weights[:, None] * unit(self.direction)


@dataclass(frozen=True)
class Mode:
    """One mode. Exactly one of `amplitude` and `amplitude_px` is given.

    The amplitude is the largest displacement over all vertices of the scene and over a cycle: in scene units (of
    a drift: scene units per second), or in pixels of the reference camera.
    """

    name: str
    field: Field
    law: TimeLaw
    amplitude: float | None = None
    amplitude_px: float | None = None
    phase: float = 0.0  # degrees; 0 is a sine, at rest at t = 0
    phases: tuple[tuple[str, float], ...] | str = ()  # further degrees per part: (glob, degrees), or RANDOM
    parts: tuple[str, ...] = ()  # globs of the parts that move; () is every part
    magnified: bool = True  # False: α leaves it alone

    @property
    def kind(self) -> str:
        return self.field.kind

    @property
    def frequency_hz(self) -> float:
        """0 for a drift."""
        return self.law.frequency_hz

    @property
    def steady(self) -> bool:
        """Return whether the motion is stationary, the same in every period."""
        return isinstance(self.law, DampedSinusoid) and self.law.decay_s is None

    def moves(self, part: str) -> bool:
        """Return whether a part moves in the mode."""
        return not self.parts or any(fnmatchcase(part, glob) for glob in self.parts)

    def phasor(self, part: str, seed: int) -> complex:
        """exp(i · phase) of a part; of several globs that match it the last one counts."""
        if isinstance(self.phases, str):
            rng = np.random.default_rng([seed, body_seed(self.name), body_seed(part)])
            return complex(phasor(self.phase + rng.uniform(0.0, 360.0)))
        extra = [degrees for glob, degrees in self.phases if fnmatchcase(part, glob)]
        return complex(phasor(self.phase + (extra[-1] if extra else 0.0)))
