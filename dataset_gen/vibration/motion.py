"""The motion of a scene: shapes of modes and bodies, scaled to their amplitudes; gains over time, motion states."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from ..errors import GenerateError
from .describe import MotionDescription
from .fields import Body, Group, Mode
from .values import SINE, TimeLaw

_ROUND = 9  # decimals of a gain: 1e-9 of an amplitude is far below float32
_ON_A_LINE = 1e-12  # how far off a line, relative, numbers that differ by rounding may lie
_MANY = 8  # names in a message


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
    """Modes on the vertices of a scene; displacement(t) = Re Σ_k shape_k · gain_k(t) (`TimeLaw` of values.py).

    Re[m z] = Re(m) Re(z) − Im(m) Im(z) is a sum over real basis shapes, and only those that are not zero are kept.
    A mode whose points all move in phase then has one gain, and falling through a height is the same state as
    rising through it.
    """

    def __init__(
        self, shapes: Sequence[np.ndarray], laws: Sequence[TimeLaw], magnified: Sequence[bool], fps: float
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


def reach(shape: np.ndarray) -> np.ndarray:
    """Largest |Re(s e^{iθ})| over all θ of vectors s [..., D]: half the major axis of their ellipses [...].

    With s = a + ib it is the larger singular value of the matrix [a, b], in closed form.
    """
    a, b = np.real(shape), np.imag(shape)
    aa, bb, ab = (a * a).sum(-1), (b * b).sum(-1), (a * b).sum(-1)
    return np.asarray(np.sqrt(0.5 * (aa + bb) + np.hypot(0.5 * (aa - bb), ab)))


def pixel_displacement(
    positions: np.ndarray, shape: np.ndarray, camera_to_world: np.ndarray, fl_x: float, fl_y: float
) -> float:
    """Largest displacement in pixels, over points and over the cycle, of a complex shape seen by a camera.

    To first order: the shape [V, 3] goes through the Jacobian of the pinhole projection at `positions` [V, 3].
    `camera_to_world` [4, 4] has OpenGL axes; focal lengths are in pixels. Points behind the camera do not count;
    hidden points do: nothing is known of what lies in front. 0 if no point counts.
    """
    rotation = np.asarray(camera_to_world, np.float64)[:3, :3]
    local = (positions - np.asarray(camera_to_world)[:3, 3]) @ rotation
    depth = -local[:, 2]
    seen = depth > 1e-9
    local, depth, moved = local[seen], depth[seen], shape[seen] @ rotation
    x, y = local[:, 0] / depth, local[:, 1] / depth
    # Depth grows against local z: d(X/depth) = (dX + x dZ) / depth.
    columns = fl_x * (moved[:, 0] + x * moved[:, 2]), fl_y * (moved[:, 1] + y * moved[:, 2])
    return float(reach(np.stack(columns, -1) / depth[:, None]).max(initial=0.0))


Reference = Callable[[np.ndarray, np.ndarray], float]


def solve(
    description: MotionDescription, bodies: Sequence[Body], fps: float, reference: Reference | None, seed: int
) -> Motion:
    """The motion of the bodies.

    A mode is scaled over all bodies together: its largest displacement, over vertices and over a cycle without
    decay, is its amplitude. `reference(positions [V, 3], shape [V, 3] complex)` gives the largest displacement
    in pixels of the camera that amplitude_px is meant for. `seed`: of random phases and directions. Raises
    GenerateError naming file, mode and key if a mode does not fit the bodies or the frame rate.
    """
    if len({body.name for body in bodies}) != len(bodies):
        raise ValueError(f"two bodies have one name: {sorted(body.name for body in bodies)}")
    modes, solved = description.modes, []
    for mode in modes:
        try:
            solved.append(_shapes(mode, bodies, fps, reference, seed))
        except ValueError as error:
            raise GenerateError(f"{description.source}: mode {mode.name!r}: {error}") from None
    shapes = [np.stack([per_body[i] for per_body in solved]) for i in range(len(bodies))]
    return Motion(shapes, [mode.law for mode in modes], [mode.magnified for mode in modes], fps)


def _shapes(
    mode: Mode, bodies: Sequence[Body], fps: float, reference: Reference | None, seed: int
) -> list[np.ndarray]:
    if mode.frequency_hz >= fps / 2:
        raise ValueError(
            f"frequency {mode.frequency_hz:g} Hz is not below half the frame rate, {fps / 2:g} Hz (fps {fps:g})"
        )
    moving = _moving(mode, bodies)
    raw = {body.name: _raw(mode, body, seed) for body in moving}
    peak = max(float(reach(shape).max(initial=0.0)) for shape in raw.values())
    if peak == 0.0:
        raise ValueError(f"it moves no vertex of {_listed(body.name for body in moving)}")
    scale = mode.amplitude / peak if mode.amplitude else _pixel_scale(mode, moving, raw, reference, peak)
    still = [np.zeros((len(body.vertices), 3), np.complex128) for body in bodies]
    return [scale * raw[body.name] if body.name in raw else s for body, s in zip(bodies, still, strict=True)]


def _raw(mode: Mode, body: Body, seed: int) -> np.ndarray:
    vertices = np.asarray(body.vertices, np.float64)
    shape = mode.field.on(body, (seed,))(vertices) * np.asarray(body.follow, np.float64)[:, None]
    if not np.isfinite(shape).all():
        raise ValueError(f"its field overflows on {body.name}: check the sizes in it")
    return np.asarray(SINE * mode.phasor(body.name, seed) * shape)


def _pixel_scale(
    mode: Mode, moving: Sequence[Body], raw: dict[str, np.ndarray], reference: Reference | None, peak: float
) -> float:
    if reference is None or mode.amplitude_px is None:
        raise ValueError(f"amplitude_px {mode.amplitude_px:g} needs a reference camera, there is none")
    pixels = max(float(reference(np.asarray(b.vertices, np.float64), raw[b.name] / peak)) for b in moving)
    if not (np.isfinite(pixels) and pixels > 0.0):
        raise ValueError(f"amplitude_px {mode.amplitude_px:g}: the reference camera does not see it move")
    return mode.amplitude_px / (pixels * peak)


def _moving(mode: Mode, bodies: Sequence[Body]) -> list[Body]:
    for glob in mode.parts:
        _matching("parts", glob, [body.name for body in bodies])
    moving = [body for body in bodies if mode.moves(body.name)]
    if not moving:
        raise ValueError("the scene has no parts")
    if not isinstance(mode.phases, str):
        for glob, _ in mode.phases:
            _matching("phases", glob, [body.name for body in moving])
    if isinstance(mode.field, Group):
        _check_group(mode.field.group, moving)
    return moving


def _check_group(group: str, moving: Sequence[Body]) -> None:
    holders = [body for body in moving if group in body.groups]
    if not holders:
        there = sorted({name for body in moving for name in body.groups})
        raise ValueError(
            f"group: no part has the vertex group {group!r}; there is {_listed(there) or 'none'}"
        )
    if not any(body.groups[group].any() for body in holders):
        names = _listed(body.name for body in holders)
        raise ValueError(
            f"group: the vertex group {group!r} of {names} is empty: no vertex has a weight in it"
        )


def _matching(key: str, glob: str, names: Sequence[str]) -> None:
    if not any(fnmatchcase(name, glob) for name in names):
        raise ValueError(f"{key}: {glob!r} matches no part; there is {_listed(names)}")


def _listed(names: Iterable[str]) -> str:
    every = list(names)
    return ", ".join(every[:_MANY]) + (f" and {len(every) - _MANY} more" if len(every) > _MANY else "")
