"""Slow changes of a line's amplitude and phase: an engine that hunts, a motor under a varying load.

    u_d(t)  =  e(t) Re[phasor_d a(t) exp(i 2π f t)],      a(t) = 1 + exp(iψ) m(t),   m real,   |m| < 1

m is of the slowest cosines cos(π k s), k = 1, 2, … K, s from 0 to 1 over the line's part of the record, of s and s²,
which have what slope m has at the ends and no cosine has, and of pairs cos, sin(2π Δ t) at rates Δ of which sidebands
were seen. All are slower than `_SLOWEST` of f; K may be 0. ψ = 0 is a modulation of the amplitude, π/2 one of the
phase. All components have the same a. Its sidebands come in pairs, as strong above f as below it. A second line is on
one side alone: a line in the model explains all of it, any m half of it at most. So whether there is a second line or
a modulation is a comparison of two models' misfits (`find.py`), each with the price of its unknowns (Schwarz 1978).

m has no mean, and its phase part no slope: amplitude, phase and frequency are the means over the record.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import lstsq

from tg4mm.core.lines.model import LineShape, design, slopes, solved
from tg4mm.core.lines.record import LONG, Record

_SLOWEST = 0.45  # of the line's frequency: sidebands further off are lines, half its frequency one of them
_SHARE = 0.125  # cosines to each sample, at most
_ENDS = 2  # columns before the cosines, s and s²
_STEPS = 4  # of the noise's level and the number of cosines in turn


def reach(record: Record, shape: LineShape) -> float:
    """Hz to either side of a line that its modulation may have sidebands at; 0 in a long record."""
    if len(record.t) > LONG:
        return 0.0
    step = float(np.median(np.diff(record.t)))
    lasting = float(record.t[-1] - record.t[shape.start])
    most = _SHARE * (len(record.t) - shape.start) / (2 * max(lasting, step))
    return min(_SLOWEST * shape.hz, most, 0.5 / step - shape.hz)


def modulated(
    record: Record, shapes: Sequence[LineShape], j: int, seen: float | None = None
) -> list[LineShape]:
    """Return the shapes with the modulation of one estimated again; none if none is significant.

    seen: offset in Hz of a pair of sidebands that is tested as well.
    """
    t, plain = record.t, replace(shapes[j], rates=(), pairs=(), modulation=None)
    out = [*shapes[:j], plain, *shapes[j + 1 :]]
    lasting = float(t[-1] - t[plain.start])
    count = int(2 * reach(record, plain) * lasting)
    if count < 1 or record.folded(plain.hz) != plain.hz:
        return out
    pairs = shapes[j].pairs if seen is None else (*shapes[j].pairs, seen)
    changes = _changes(plain, t, count, pairs)
    phasor, residual = solved(out, t, record.y)[0][j], solved(out, t, record.y)[1]
    columns, left, across = _beside(record, out, j, phasor, changes)
    bases = [np.linalg.qr(each)[0] for each in columns]
    best = (0.0, 0, 0.0)  # of what cost, how many columns, which angle
    for _ in range(_STEPS):
        each = _directed(columns, best[2])[:, : best[1]]
        now = left - each @ _least_squares(each, left) if best[1] else left
        beside = residual - (left - now).reshape(len(t), -1) @ across.T
        floor = record.floor(beside, shapes)[0]
        level = float(floor[record.bin_of(plain.hz, len(floor))].mean())
        last, best = best, _best(columns, bases, left, 2 * len(pairs), level * np.log(len(t)))
        if last[1:] == best[1:]:
            break
    if not best[1]:
        return out
    m = _least_squares(_directed(columns, best[2])[:, : best[1]], left)
    change = _centred(plain, t, np.exp(1j * best[2]) * (changes[:, : best[1]] @ m))
    if np.abs(change).max() >= 1:
        return out
    rates = [2 * lasting * off for off in pairs for _ in range(2)] + [0.0] * _ENDS + list(range(1, count + 1))
    out[j] = replace(plain, rates=tuple(rates[: best[1]]), pairs=pairs, modulation=1 + change)
    return out


def _least_squares(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the coefficients of columns that are nearly dependent, on which LAPACK's default SVD may not converge."""
    return np.asarray(lstsq(a, b, lapack_driver="gelsy", check_finite=False)[0])


def _directed(columns: np.ndarray, angle: float) -> np.ndarray:
    return np.asarray(np.cos(angle) * columns[0] + np.sin(angle) * columns[1])


def _best(
    columns: np.ndarray, bases: list[np.ndarray], left: np.ndarray, first: int, price: float
) -> tuple[float, int, float]:
    """Cost, number of columns and angle that cost least; price: of each unknown.

    Columns [2, N, K] of both directions; there are none of them, the `first` alone, or those and all up to any.
    """
    count = columns.shape[2]
    allowed = np.zeros(count + 1, bool)
    allowed[[0, first]] = allowed[first + _ENDS + 1 :] = True
    prices = np.where(allowed, price * np.arange(count + 1), np.inf)
    gains = [np.concatenate([[0.0], np.cumsum((basis.T @ left) ** 2)]) for basis in bases]
    n = int((2 * prices - sum(gains)).argmin())
    options = [(0.0, prices - gains[0]), (np.pi / 2, prices - gains[1])]
    if n:
        flat = np.concatenate([columns[0][:, :n], columns[1][:, :n]], 1)
        parts = _least_squares(flat, left)
        series = (parts[:n] + 1j * parts[n:]) * np.sqrt((columns[0][:, :n] ** 2).sum(0))
        angle = float(np.angle((series**2).sum()) / 2)
        basis = np.linalg.qr(_directed(columns, angle)[:, :n])[0]
        joint = prices.copy()
        joint[1 : n + 1] += price - np.cumsum((basis.T @ left) ** 2)
        joint[n + 1 :] = np.inf
        options.append((angle, joint))
    found = (0.0, 0, 0.0)
    for angle, costs in options:
        k = int(costs[1:].argmin()) + 1
        found = min(found, (float(costs[k]), k, angle))
    return found


def unknowns(shapes: Sequence[LineShape]) -> int:
    """Return the number of unknowns of all modulations."""
    return sum(len(s.rates) for s in shapes)


def _changes(shape: LineShape, t: np.ndarray, count: int, pairs: Sequence[float]) -> np.ndarray:
    """Return [T, K]: pairs, s, s² and `count` cosines, 0 before the line begins."""
    begin = t[shape.start]
    since = ((t - begin) / (t[-1] - begin))[:, None]
    waves = [np.exp(2j * np.pi * off * (t - begin))[:, None] for off in pairs]
    sides = [part - part[shape.start :].mean() for w in waves for part in (w.real, w.imag)]
    out = np.hstack([*sides, since, since**2, np.cos(np.pi * np.arange(1, count + 1) * since)])
    out[: shape.start] = 0
    return np.asarray(out)


def _beside(
    record: Record, shapes: Sequence[LineShape], j: int, phasor: np.ndarray, changes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns [2, N, K] of changes in amplitude and in phase and the values [N], both beside all else that is fitted.

    Of the components only the two directions count that the line moves in: also [D, 2 at most] these.
    """
    t = record.t
    across = np.linalg.svd(np.stack([phasor.real, phasor.imag], 1), full_matrices=False)
    kept = across[0][:, across[1] > 1e-9 * across[1].max()]
    modulated, wave = phasor @ kept, shapes[j].wave(t)
    n = len(modulated)
    x = np.kron(design(shapes, t), np.eye(n))  # rows: time, then component
    bent = [c.ravel()[:, None] for c in slopes(shapes[j], modulated, t, wave)]
    basis = np.linalg.qr(np.hstack([x, *bent]))[0]
    turning = wave[:, None] * modulated
    columns = np.stack(
        [
            (part.real[:, :, None] * changes[:, None]).reshape(len(t) * n, -1)
            for part in (turning, 1j * turning)
        ]
    )
    columns = columns - basis @ (basis.T @ columns)
    y = (record.y @ kept).ravel()
    return columns, y - basis @ (basis.T @ y), kept


def _centred(shape: LineShape, t: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Remove the line's mean amplitude, phase and frequency from a change, and its decay where that is fitted."""
    weights = shape.envelope(t)
    since = t - t[shape.start]
    out = np.zeros(len(t), complex)
    for part, turn, degree in ((change.real, 1, int(shape.is_free)), (change.imag, 1j, 1)):
        x = np.vander(since, degree + 1) * weights[:, None]
        out += turn * (
            part - np.vander(since, degree + 1) @ np.linalg.lstsq(x, part * weights, rcond=None)[0]
        )
    out[: shape.start] = 0
    return out
