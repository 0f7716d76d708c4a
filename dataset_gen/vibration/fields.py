"""Displacement fields: rigid motions, twist, soft bodies, vertex groups; the base of all kinds.

A field maps rest points [V, 3] to displacements [V, 3], real or complex, of any scale: the mode's amplitude
scales it. Fields are frozen dataclasses; their names are the keys of the motion description, and the type of
each says how the key is read (values.py).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from .bodies import Body
from .geometry import across, unit
from .values import Direction, MaybePositive, Point, Positive, Text, Triple, direction, number, vector, whole

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
        """[V], 0 where it is held."""
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
