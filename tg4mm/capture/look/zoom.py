"""Zoom and roll of the camera: motion of the complete picture about its middle, beside its shift.

A lens that focuses scales the picture (focus breathing); a camera that turns about its optical axis rolls it. Either
has one time course over the complete picture, unlike a vibrating object: every quarter of the picture follows the time
course of the three others, so that a regression has slope one; it is zero if there is only noise or one moving object.
"""

from collections.abc import Sequence

import numpy as np

from tg4mm.capture.look.model import GlobalMotion, LookLine
from tg4mm.capture.look.spectra import without

SHAPES = ("zoom", "roll")
_SURE = 4.0  # deviations of each quarter's slope: one of 10⁹ courses of noise reaches that in three quarters
_ALIKE = 0.3  # of their median, by which quarters' slopes may differ besides their deviations
_FEWEST_QUARTERS, _FEWEST_CELLS = 3, 4
_LEFT = 0.3  # of the whole picture's amplitude in its corners: what is less is what it leaves
_STEPS = 3  # of reweighting: cells that move by themselves count less


def designs(places: np.ndarray, size: tuple[int, int], shapes: Sequence[str] = SHAPES) -> np.ndarray:
    """Return [C, 2, 2 + m]: shifts of cells at places [C, 2] px by a unit of the camera's shift, and of each shape.

    A shape's unit is one pixel in the corners of the picture, width and height `size`.
    """
    x, y = ((places - np.array(size) / 2) / (np.hypot(*size) / 2)).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    columns = {"zoom": (x, y), "roll": (-y, x)}
    return np.stack([np.stack(c, 1) for c in [(one, zero), (zero, one), *(columns[s] for s in shapes)]], 2)


def fitted(design: np.ndarray, weights: np.ndarray, counts: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return [F, 2 + m]: weighted least squares of shifts [F, C, 2]; weights [C, 2, 2], counts [F, C]."""
    by_weight = design.transpose(0, 2, 1) @ weights
    products = np.einsum("kc,cij->kij", counts, by_weight @ design)
    by_shift = np.einsum("kc,cij,kcj->ki", counts, by_weight, shift, optimize=True)
    unknowns = design.shape[2]
    return np.asarray(np.linalg.solve(products + 1e-9 * np.eye(unknowns), by_shift[..., None])[..., 0])


def camera_shapes(
    places: np.ndarray,
    size: tuple[int, int],
    weights: np.ndarray,
    counts: np.ndarray,
    shift: np.ndarray,
    nuisance: np.ndarray,
) -> tuple[str, ...]:
    """Return the SHAPES that the complete picture follows. nuisance [F, P]: functions of time fitted beside them."""
    design = designs(places, size)
    for _ in range(_STEPS):
        left = shift - np.einsum("cip,kp->kci", design, fitted(design, weights, counts, shift))
        error = np.einsum("kc,kci,cij,kcj->c", counts, left, weights, left, optimize=True)
        error = np.sqrt(error / np.maximum(counts.sum(0), 1))
        some = error > 0
        if not some.any():
            return ()
        weights = weights / (1 + (error / np.median(error[some])) ** 2)[:, None, None]
    corner = (places > np.array(size) / 2) @ [1, 2]
    slopes = [_slopes(design, weights, counts, shift, nuisance, corner == k) for k in range(4)]
    answers = np.array([s for s in slopes if s is not None])  # [Q, m, 2]
    if len(answers) < _FEWEST_QUARTERS:
        return ()
    slope, sure = answers[..., 0], answers[..., 1]
    middle = np.median(slope, 0)
    alike = np.abs(slope - middle) < _ALIKE * middle + 2 * np.abs(slope) / np.maximum(sure, _SURE)
    is_one = ((sure > _SURE) & alike).all(0)
    return tuple(shape for shape, there in zip(SHAPES, is_one, strict=True) if there)


def _slopes(
    design: np.ndarray,
    weights: np.ndarray,
    counts: np.ndarray,
    shift: np.ndarray,
    nuisance: np.ndarray,
    here: np.ndarray,
) -> np.ndarray | None:
    """Return slopes [m, 2] of a quarter's time course on the others', and their ratio to their ±; None for few."""
    inner, others = counts * here, counts * ~here
    if (inner.sum(0) > 0).sum() < _FEWEST_CELLS or (others.sum(0) > 0).sum() < 2 * _FEWEST_CELLS:
        return None
    course = fitted(design, weights, others, shift)
    out = []
    for k in range(2, design.shape[2]):
        rest = np.delete(np.arange(design.shape[2]), k)
        left = shift - np.einsum("cip,kp->kci", design[..., rest], course[:, rest])
        column = design[..., k]
        size = np.einsum("kc,ci,cij,cj->k", inner, column, weights, column, optimize=True)
        along = np.einsum("kc,ci,cij,kcj->k", inner, column, weights, left, optimize=True)
        rows = size > 0.5 * np.median(size)
        if rows.sum() <= 2 * nuisance.shape[1]:
            return None
        y, z = without(np.stack([along[rows] / size[rows], course[rows, k]], 1), nuisance[rows]).T
        slope = float(y @ z / max(z @ z, 1e-30))
        noise = y - slope * z
        alike = max(_lag(noise) * _lag(z), 0.0)  # fewer independent pictures (Bartlett 1935)
        variance = noise @ noise / len(y) / max(z @ z, 1e-30) * (1 + alike) / (1 - min(alike, 0.98))
        out.append((slope, slope / max(variance, 1e-30) ** 0.5))
    return np.array(out)


def _lag(series: np.ndarray) -> float:
    """Return the correlation of neighbouring samples."""
    return float(series[1:] @ series[:-1] / max(series @ series, 1e-30))


def left_of(line: LookLine, swings: Sequence[GlobalMotion], duration_s: float) -> str:
    """Return why a line at the frequency of a global motion may be its residual; empty if it is not."""
    for swing in swings:
        for tone in swing.tones:
            if abs(tone.hz - line.hz) < 1 / duration_s and line.amplitude_px < _LEFT * tone.amplitude:
                return f"faint beside the whole picture's {swing.kind} at {tone.hz:.4g} Hz"
    return ""


def swing_note(swing: GlobalMotion, size: tuple[int, int]) -> str:
    """Describe the whole picture's motion, in pictures of a width and height, and its likely cause."""
    if swing.kind == "light":
        return (
            f"changes by {100 * swing.largest:.3g} %, fastest at {swing.at_s:.1f} s: exposure or lamps; the change is "
            "removed"
        )
    share = swing.largest / (np.hypot(*size) / 2)
    if swing.kind == "zoom":
        what, by, why = (
            "grows and shrinks",
            f"{share:.2%}",
            "the lens focuses, or the camera moves to and fro",
        )
    else:
        what, by, why = "turns", f"{np.degrees(share):.2g}°", "the camera turns about its sight"
    lines = "".join(f", at {tone.hz:.4g} Hz by {tone.amplitude:.2g} px" for tone in swing.tones)
    return (
        f"{what} about its middle by up to {swing.largest:.2g} px in its corners ({by}), most at {swing.at_s:.1f} s"
        f"{lines}: {why}; it is taken off, and what vibrates in that shape with it"
    )
