"""Vibration as data: modes with analytic displacement fields, and the motion state they give at a time.

A mode moves the rest point x by Re[A · p · s(x) · exp(i 2π f t / fps)], with amplitude A (scene units),
phasor p (−i: sine, zero at t = 0) and shape s. Magnified by α, every displacement is (1 + α) times that
([TG4MM] Eq. (9)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

SINE = -1j  # Re[−i s exp(iωt)] = s sin ωt: the reference frame, t = 0, is the rest pose

# First bending mode of a clamped-free Euler–Bernoulli beam: the first root of cosh β cos β = −1.
_BETA = 1.8751040687119611
_SIGMA = 0.7340955137589128


class Field(Protocol):
    """A displacement shape: rest points [V, 3] to displacements [V, 3], real or complex, any scale."""

    @property
    def kind(self) -> str: ...

    def __call__(self, points: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True)
class Cantilever:
    """First bending mode of an upright beam clamped at height `base_z`; what it carries follows rigidly.

    Cross-sections turn with the slope of the beam (Euler–Bernoulli), so the field is continuous through
    everything that touches, and exactly zero at and below `base_z`. It is 1 at the tip of the beam.
    """

    kind: ClassVar[str] = "bending"
    base_z: float  # scene units
    length: float  # of the beam that bends, scene units
    direction: tuple[float, float]  # in which it sways, horizontal, need not be normalised
    axis_xy: tuple[float, float] = (0.0, 0.0)  # where the beam stands

    def profile(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Deflection w(z) with w(tip) = 1, and its slope dw/dz in 1/scene unit."""
        height = np.asarray(z, np.float64) - self.base_z
        b = _BETA * np.clip(height / self.length, 0.0, 1.0)
        deflection = 0.5 * (np.cosh(b) - np.cos(b) - _SIGMA * (np.sinh(b) - np.sin(b)))
        slope = 0.5 * (np.sinh(b) + np.sin(b) - _SIGMA * (np.cosh(b) - np.cos(b))) * _BETA / self.length
        return deflection + slope * np.maximum(height - self.length, 0.0), slope

    def __call__(self, points: np.ndarray) -> np.ndarray:
        deflection, slope = self.profile(points[:, 2])
        sway = np.array(self.direction) / np.hypot(*self.direction)
        lever = (points[:, :2] - np.array(self.axis_xy)) @ sway
        return np.column_stack([deflection[:, None] * sway, -slope * lever])


@dataclass(frozen=True)
class Mode:
    """One mode of vibration: a shape, how far it goes, how fast, and where in its cycle it is at t = 0."""

    name: str
    frequency_hz: float
    amplitude: float  # largest displacement over all vertices of the scene, scene units
    field: Field
    phasor: complex = SINE  # of modulus 1

    def describe(self) -> dict[str, object]:
        """What `scene.json` says of the mode."""
        return {
            "name": self.name,
            "kind": self.field.kind,
            "frequency_hz": self.frequency_hz,
            "amplitude": self.amplitude,
            "phasor": [self.phasor.real, self.phasor.imag],
        }


def mode_shapes(modes: Sequence[Mode], parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """Complex mode shapes of all parts: per part [K, V, 3] complex128, scene units.

    `parts` holds (rest [V, 3], follow [V]) of every part; `follow` in 0..1 is how much a vertex goes along
    with the field (0: held). A mode is scaled over all parts together, so its amplitude is the scene's
    largest.
    """
    per_mode = []
    for mode in modes:
        raw = [mode.field(rest) * follow[:, None] for rest, follow in parts]
        peak = max(float(np.linalg.norm(shape, axis=1).max(initial=0.0)) for shape in raw)
        if peak == 0.0:
            raise ValueError(f"mode {mode.name!r} moves no vertex")
        per_mode.append([mode.phasor * (mode.amplitude / peak) * shape for shape in raw])
    return [np.stack([shapes[i] for shapes in per_mode]) for i in range(len(parts))]


@dataclass(frozen=True)
class State:
    """A motion state: the gains of the real basis shapes. Two timesteps of equal state look the same."""

    gains: tuple[float, ...]

    @property
    def at_rest(self) -> bool:
        return all(gain == 0.0 for gain in self.gains)


class Motion:
    """Modes on the vertices of a scene: Re[m z] = Re(m) Re(z) − Im(m) Im(z), a sum over real basis shapes.

    Only the real or imaginary parts that are non-zero somewhere are kept. A real shape that goes as a sine
    then has one gain, and falling through a height is the same state as rising through it.
    """

    def __init__(self, shapes: Sequence[np.ndarray], frequencies_hz: Sequence[float], fps: float) -> None:
        self.frequencies_hz = tuple(float(f) for f in frequencies_hz)
        self.fps = float(fps)
        self._used = [
            (k, imaginary)
            for k in range(len(self.frequencies_hz))
            for imaginary in (False, True)
            if any(np.any(s[k].imag if imaginary else s[k].real) for s in shapes)
        ]
        #: per part [G, V, 3] float64, scene units
        self.basis = [
            np.stack([-s[k].imag if imaginary else s[k].real for k, imaginary in self._used]) for s in shapes
        ]

    def state(self, timestep: int, alpha: float = 0.0) -> State:
        """The state at a timestep with every displacement magnified to (1 + α) times its size."""
        gains = []
        for k, imaginary in self._used:
            turn = (self.frequencies_hz[k] * timestep / self.fps) % 1.0
            z = (1.0 + alpha) * np.exp(2j * np.pi * turn)
            # Rounding makes sin 60° and sin 120° the same number; 1e-9 of an amplitude is far below float32.
            gains.append(round(float(z.imag if imaginary else z.real), 9) + 0.0)
        return State(tuple(gains))

    def displacement(self, part: int, state: State) -> np.ndarray:
        """Displacement from rest of one part's vertices, [V, 3] float64, scene units; linear in the gains."""
        return np.tensordot(np.array(state.gains), self.basis[part], axes=1)
