"""How a small tree branches: stems, drooping limbs on them, twigs on those, and places for leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..meshes import spline

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class Axis:
    """A woody axis: its middle line and its radius along it."""

    path: np.ndarray  # [P, 3]
    radius: np.ndarray  # [P]

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Point, direction and radius at a share t of the way."""
        place = t * (len(self.path) - 1)
        i = min(int(place), len(self.path) - 2)
        step = self.path[i + 1] - self.path[i]
        radius = float(np.interp(place, np.arange(len(self.radius)), self.radius))
        return self.path[i] + (place - i) * step, step / np.linalg.norm(step), radius


def drooping(
    start: np.ndarray,
    heading: np.ndarray,
    length: float,
    droop: float,
    radii: tuple[float, float],
    rng: np.random.Generator,
    wander: float = 0.12,
    points: int = 14,
) -> Axis:
    """An axis that leaves along `heading` and sinks under its weight, by `droop` × length at its end."""
    t = np.linspace(0.0, 1.0, points)[:, None]
    across = rng.normal(size=(2, 3)) * wander * length
    path = start + length * t * heading + across[0] * t**2 * (1.0 - t) * 2.0 + across[1] * t**2 * 0.5
    path[:, 2] -= droop * length * t[:, 0] ** 2
    return Axis(path, radii[0] + (radii[1] - radii[0]) * t[:, 0] ** 0.8)


def stem(points: np.ndarray, radii: tuple[float, float], flare: float, rng: np.random.Generator) -> Axis:
    """A trunk through points, with knots and swellings, flared by `flare` at its foot."""
    path = spline(list(points), 10)
    t = np.linspace(0.0, 1.0, len(path))
    radius = radii[0] + (radii[1] - radii[0]) * t
    knots = 1.0 + 0.1 * np.sin(2.0 * np.pi * (6.5 * t + rng.uniform())) * np.sin(
        2.0 * np.pi * (2.3 * t + rng.uniform())
    )
    return Axis(path, radius * knots * (1.0 + flare * np.exp(-t / 0.06)))


def limbs(
    trunk: Axis,
    count: int,
    first: float,
    length: tuple[float, float],
    rng: np.random.Generator,
    turn: float = 0.0,
) -> list[Axis]:
    """Limbs around a trunk from a share `first` of its height to its top; they start inside the wood."""
    made = []
    for k, t in enumerate(np.linspace(first, 0.99, count)):
        point, _, radius = trunk.at(float(t))
        azimuth = turn + k * _GOLDEN + rng.uniform(-0.3, 0.3)
        rise = np.radians(28.0 + 42.0 * (t - first) / (1.0 - first) + rng.uniform(-8.0, 8.0))
        heading = np.array([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)])
        reach = length[0] + (length[1] - length[0]) * t + rng.uniform(-0.05, 0.05)
        thick = 0.62 * radius
        made.append(drooping(point, heading, reach, 0.32, (thick, 0.3 * thick), rng))
    return made


def twigs(limb: Axis, count: int, length: tuple[float, float], rng: np.random.Generator) -> list[Axis]:
    """Twigs on alternate sides of a limb; the last one goes on from its end."""
    made = []
    for k, t in enumerate(np.linspace(0.3, 1.0, count)):
        point, along, radius = limb.at(float(t))
        side = np.cross(along, [0.0, 0.0, 1.0])
        side = side / np.linalg.norm(side) * (1.0 if k % 2 else -1.0) * (0.25 if t == 1.0 else 1.0)
        heading = along * 0.8 + side * rng.uniform(0.5, 1.0) + np.array([0.0, 0.0, rng.uniform(-0.1, 0.35)])
        heading /= np.linalg.norm(heading)
        reach = rng.uniform(*length)
        thick = 0.8 * min(radius, 0.0045)
        made.append(drooping(point, heading, reach, 0.38, (thick, 0.4 * thick), rng, points=9))
    return made


def leaf_places(twig: Axis, spacing: float, rng: np.random.Generator, first: float = 0.12) -> np.ndarray:
    """Frames [N, 4, 4] of leaf stalks on alternate sides of a twig: x outwards from the wood, z roughly up."""
    length = float(np.linalg.norm(np.diff(twig.path, axis=0), axis=1).sum())
    count = max(3, round(length * (1.0 - first) / spacing))
    frames = np.tile(np.eye(4), (count, 1, 1))
    for k, t in enumerate(np.linspace(first, 1.0, count)):
        point, along, _ = twig.at(float(t))
        side = np.cross(along, [0.0, 0.0, 1.0])
        side = side / np.linalg.norm(side) * (1.0 if k % 2 else -1.0)
        out = (
            0.75 * along
            + side * rng.uniform(0.5, 1.2) * (0.2 if k == count - 1 else 1.0)
            + rng.normal(size=3) * 0.2
        )
        out[2] -= rng.uniform(0.0, 0.5)
        out /= np.linalg.norm(out)
        up = np.array([0.0, 0.0, 1.0]) + rng.normal(size=3) * 0.38
        up -= out * (up @ out)
        up /= np.linalg.norm(up)
        frames[k, :3, :3] = np.column_stack([out, np.cross(up, out), up])
        frames[k, :3, 3] = point
    return frames
