"""Phasors in x, y, z of several sensors and the phases of clips that show them, by weighted least squares together.

Clip c shows  exp(iθ_c) W p + unit noise  of a sensor's phasor p [3] (`clips.py`). Gauss-Newton on p of every sensor and
every θ_c but that of the clip that shows most. Known phases count as measurements with Cauchy-distributed errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.show.measure.series import UNSEEN

PHASE_RAD = 0.1  # scale of the error of a phase by the motion stage (docs/protocol.md: 1°, 4°, 12°, once 71°)
_STARTS, _TURNS = 24, 60  # random phases, where none are known, and steps from each
_STEPS = 30  # of Gauss-Newton


@dataclass(frozen=True)
class Rows:
    """One sensor on one clip: `seen` [m] = exp(iθ) `design` [m, 3] p + noise of unit variance."""

    design: np.ndarray
    seen: np.ndarray


def triangulated(
    rows: Sequence[Sequence[Rows]], known: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Phasors [S, 3] and their variances (of real and imaginary part), phases [C] and their deviations.

    rows [S][C]; known [C]: phases by the motion stage.
    """
    count = len(rows[0])
    theta = _phases_alone(rows) if known is None else known.copy()
    fixed = int(np.argmax([sum(float((abs(r[c].seen) ** 2).sum()) for r in rows) for c in range(count)]))
    free = [c for c in range(count) if c != fixed]
    p = _given(rows, theta)
    for _ in range(_STEPS):
        jacobian, left = _linearised(rows, p, theta, free, known)
        step = np.linalg.lstsq(jacobian, left, rcond=None)[0]
        p = p + (step[: 3 * len(rows)] + 1j * step[3 * len(rows) : 6 * len(rows)]).reshape(-1, 3)
        theta[free] += step[6 * len(rows) :]
        if np.abs(step[6 * len(rows) :]).max(initial=0.0) < 1e-7:
            break
    jacobian, _ = _linearised(rows, p, theta, free, known)
    spread = np.diag(np.linalg.pinv(jacobian.T @ jacobian, rcond=UNSEEN**2))
    both = (spread[: 3 * len(rows)] + spread[3 * len(rows) : 6 * len(rows)]).reshape(-1, 3) / 2
    variance = np.stack([_checked(own, p[s], both[s], theta) for s, own in enumerate(rows)])
    deviation = np.zeros(count)
    deviation[free] = np.sqrt(spread[6 * len(rows) :])
    p, theta = (p, theta) if known is not None else (p * np.exp(1j * theta[0]), theta - theta[0])
    return p, variance, (theta + np.pi) % (2 * np.pi) - np.pi, deviation


def _checked(rows: Sequence[Rows], phasor: np.ndarray, variance: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """[3] variance of a sensor's phasor, larger by what the clips disagree on; inf along what none of them shows."""
    left = [r.seen - np.exp(1j * t) * (r.design @ phasor) for r, t in zip(rows, theta, strict=True)]
    total, free = sum(float((abs(e) ** 2).sum()) for e in left), 2 * sum(map(len, left)) - 6
    values, vectors = np.linalg.eigh(sum((r.design.T @ r.design for r in rows), np.zeros((3, 3))))
    hidden = (vectors[:, values <= UNSEEN * max(values[-1], 1e-300)] ** 2).sum(1)
    return np.where(hidden > 0.5, np.inf, variance * max(total / free if free > 0 else 1.0, 1.0))


def _given(rows: Sequence[Sequence[Rows]], theta: np.ndarray) -> np.ndarray:
    """[S, 3] phasors for known phases."""
    out = []
    for own in rows:
        design = np.concatenate([r.design for r in own])
        seen = np.concatenate([r.seen * np.exp(-1j * t) for r, t in zip(own, theta, strict=True)])
        out.append(np.linalg.lstsq(design.astype(complex), seen, rcond=UNSEEN)[0])
    return np.array(out).reshape(-1, 3)


def _phases_alone(rows: Sequence[Sequence[Rows]]) -> np.ndarray:
    """[C] phases by turns with the phasors, the best of many random starts."""
    rng, best, out = np.random.default_rng(0), -np.inf, np.zeros(len(rows[0]))
    for _ in range(_STARTS):
        theta = rng.uniform(0, 2 * np.pi, len(rows[0]))
        for _ in range(_TURNS):
            p = _given(rows, theta)
            shown = [[r.design @ p[s] for r in own] for s, own in enumerate(rows)]
            products = np.array(
                [
                    sum(np.vdot(shown[s][c], own[c].seen) for s, own in enumerate(rows))
                    for c in range(len(theta))
                ]
            )
            theta = np.angle(products)
        if (score := float(np.abs(products).sum())) > best:
            best, out = score, theta
    return out


def _linearised(
    rows: Sequence[Sequence[Rows]],
    p: np.ndarray,
    theta: np.ndarray,
    free: Sequence[int],
    known: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian and what is left, of real parts, imaginary parts, and the known phases.

    Unknowns: real parts of the phasors [3S], imaginary parts [3S], phases of the clips `free`.
    """
    n = 3 * len(rows)
    jacobian, left = [], []
    for s, own in enumerate(rows):
        for c, r in enumerate(own):
            turned = np.exp(1j * theta[c]) * r.design
            block = np.zeros((len(r.seen), 2 * n + len(free)), complex)
            block[:, 3 * s : 3 * s + 3], block[:, n + 3 * s : n + 3 * s + 3] = turned, 1j * turned
            if c in free:
                block[:, 2 * n + free.index(c)] = 1j * (turned @ p[s])
            rest = r.seen - turned @ p[s]
            jacobian += [block.real, block.imag]
            left += [rest.real, rest.imag]
    if known is not None:
        away = np.angle(np.exp(1j * (known - theta)))[list(free)]
        weight = 1 / np.sqrt(PHASE_RAD**2 + away**2)  # Cauchy's, by reweighting
        jacobian.append(np.concatenate([np.zeros((len(free), 2 * n)), np.diag(weight)], 1))
        left.append(weight * away)
    return np.concatenate(jacobian), np.concatenate(left)
