"""The motion of a scene: complex mode shapes on its vertices, their gains over time, and motion states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .values import TimeLaw

_ROUND = 9  # decimals of a gain: 1e-9 of an amplitude is far below float32
_ON_A_LINE = 1e-12  # how far off a line, relative, numbers that differ by rounding may lie


@dataclass(frozen=True)
class State:
    """A motion state: the gains of the real basis shapes. Two timesteps of equal state look the same."""

    gains: tuple[float, ...]

    @property
    def at_rest(self) -> bool:
        return all(gain == 0.0 for gain in self.gains)


@dataclass(frozen=True)
class Basis:
    """One real basis shape: the part of mode k in phase with `turn`, or a quarter turn off it."""

    mode: int
    turn: complex  # of modulus 1; the shape is Re(m_k / turn), or −Im(m_k / turn) if `quadrature`
    quadrature: bool

    def shape(self, m: np.ndarray) -> np.ndarray:
        turned = m[self.mode] * self.turn.conjugate()
        return np.ascontiguousarray(-turned.imag if self.quadrature else turned.real)

    def gain(self, gains: np.ndarray) -> np.ndarray:
        """Real gain of the shape, of the gains [K, T] of the modes."""
        turned = gains[self.mode] * self.turn
        return turned.imag if self.quadrature else turned.real


class Motion:
    """Modes on the vertices of a scene; displacement(t) = Re Σ_k shape_k · gain_k(t) (see timelaw.py).

    Re[m z] = Re(m) Re(z) − Im(m) Im(z) is a sum over real basis shapes, and only those that are not zero are kept.
    A mode whose points all move in phase then has one gain, and falling through a height is the same state as
    rising through it.
    """

    def __init__(
        self,
        shapes: Sequence[np.ndarray],
        laws: Sequence[TimeLaw],
        magnified: Sequence[bool],
        fps: float,
    ) -> None:
        """`shapes`: per body complex [K, V, 3], scene units. Raises ValueError if the numbers K differ."""
        counts = {len(laws), len(magnified), *(len(s) for s in shapes)}
        if len(counts) != 1:
            raise ValueError(f"numbers of modes differ: {sorted(counts)}")
        self.fps = float(fps)
        self.shapes = [np.asarray(s, np.complex128) for s in shapes]
        self.magnified = np.array(magnified, bool)
        self.frequencies_hz = np.array([law.frequency_hz for law in laws], np.float64)
        self.laws = tuple(laws)
        #: [G], what each real basis shape is
        self.bases = [basis for k in range(len(laws)) for basis in _bases(k, [s[k] for s in self.shapes])]
        #: per body the real basis shapes [G, V, 3] float64, scene units
        self.basis = [
            np.stack([b.shape(s) for b in self.bases]) if self.bases else np.zeros((0, *s.shape[1:]))
            for s in self.shapes
        ]

    def gains(self, n_timesteps: int) -> np.ndarray:
        """Complex gains of the modes [K, T] at timesteps 0 … T − 1, at α = 0."""
        return self._gains(np.arange(n_timesteps))

    def basis_gains(self, timesteps: np.ndarray, alpha: float = 0.0) -> np.ndarray:
        """Real gains [G, T] of the basis shapes at any timesteps [T], fractions allowed, not rounded."""
        gains = self._gains(np.asarray(timesteps, np.float64)) * self._factors(alpha)[:, None]
        return np.array([b.gain(gains) for b in self.bases]).reshape(len(self.bases), -1)

    @property
    def rest(self) -> State:
        """The state in which nothing is displaced."""
        return State(tuple(0.0 for _ in self.bases))

    def state(self, timestep: float, alpha: float = 0.0) -> State:
        """The state at a timestep, fractions allowed; displacements of magnified modes (1 + α) times their size."""
        # Rounding makes sin 60° and sin 120° the same number; + 0.0 makes −0 and 0 one.
        gains = self.basis_gains(np.array([timestep]), alpha)[:, 0].round(_ROUND) + 0.0
        return State(tuple(gains.tolist()))

    def displacement(self, body_index: int, state: State) -> np.ndarray:
        """Displacement from rest of one body's vertices, [V, 3] float64, scene units; linear in the gains."""
        return np.tensordot(np.array(state.gains), self.basis[body_index], axes=1)

    def _gains(self, timesteps: np.ndarray) -> np.ndarray:
        gains = [law.gain(timesteps, self.fps) for law in self.laws]
        return np.array(gains, np.complex128).reshape(len(self.laws), -1)

    def _factors(self, alpha: float) -> np.ndarray:
        return np.where(self.magnified, 1.0 + alpha, 1.0)


def _bases(k: int, shapes: Sequence[np.ndarray]) -> list[Basis]:
    """The real shapes that mode k needs: one if all its numbers lie on a line through 0, else two."""
    peak, turn = 0.0, 1.0 + 0.0j
    for shape in shapes:
        if shape.size:
            largest = complex(shape.ravel()[np.abs(shape).argmax()])
            if abs(largest) > peak:
                peak, turn = abs(largest), largest / abs(largest)
    if peak == 0.0:
        return []
    if all((np.abs((s * turn.conjugate()).imag) <= _ON_A_LINE * peak).all() for s in shapes):
        # Of the two directions along the line the one whose gain is a rising sine, or a positive cosine.
        sign = -1.0 if turn.imag > 0.0 or (turn.imag == 0.0 and turn.real < 0.0) else 1.0
        return [Basis(k, sign * turn, False)]
    return [Basis(k, 1.0 + 0.0j, quadrature) for quadrature in (False, True)]
