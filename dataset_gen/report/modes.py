"""Modes one by one: which parts they move, how they look from a camera, and one point over time."""

from dataclasses import dataclass, replace

import numpy as np

from ..vibration import reach
from .dataset import Dataset, MotionTruth
from .pixels import Seen

_MOST_NAMES = 6
_ONE_SURFACE = 0.05  # share of its motion by which a pixel may differ from the fit and still see one surface


@dataclass(frozen=True)
class ModeSummary:
    """One mode of truth/motion.npz."""

    frequency_hz: float
    amplitude: float  # largest over all vertices, scene units; of the gains, the largest is taken
    parts: tuple[tuple[str, float], ...]  # objects that move, with their largest displacement
    moving_area: float  # share of the surface area that is displaced by more than a millionth of it


@dataclass(frozen=True)
class Track:
    """One surface point over time."""

    where: str
    view: str  # test camera that sees it, "" for a vertex that was not looked for in a picture
    pixel: tuple[int, int]  # row and column in that view
    displacement: np.ndarray  # [T, 3] scene units
    direction: np.ndarray  # [3] unit vector along which it moves most

    @property
    def along(self) -> np.ndarray:
        """[T] displacement along `direction`, scene units."""
        return self.displacement @ self.direction


def summarise(motion: MotionTruth) -> list[ModeSummary]:
    """Every mode, in the order of the file."""
    areas = [_vertex_areas(body.rest, body.faces) for body in motion.bodies]
    total = sum(float(a.sum()) for a in areas)
    found = []
    for k, frequency in enumerate(motion.frequencies_hz):
        gain = float(np.abs(motion.gains[:, k]).max(initial=0.0))
        sizes = [gain * reach(body.modes[k]) for body in motion.bodies]
        peaks = [float(size.max(initial=0.0)) for size in sizes]
        top = max(peaks, default=0.0)
        moved = sum(float(a[s > 1e-6 * top].sum()) for a, s in zip(areas, sizes, strict=True)) if top else 0.0
        names = [(b.name, p) for b, p in zip(motion.bodies, peaks, strict=True) if top and p > 1e-6 * top]
        names.sort(key=lambda named: -named[1])
        found.append(ModeSummary(float(frequency), top, tuple(names), moved / total if total else 0.0))
    return found


def together(motion: MotionTruth) -> tuple[MotionTruth, list[list[int]]]:
    """The motion with modes of equal gains added up, and which modes each sum holds.

    What goes alike in time, parts of a scene at one frequency for example, cannot be told apart by time, and is
    one motion to look at.
    """
    groups: list[list[int]] = []
    for k in range(len(motion.frequencies_hz)):
        gain = motion.gains[:, k]
        same = (g for g in groups if np.allclose(motion.gains[:, g[0]], gain, atol=1e-9))
        group = next(same, None)
        if group is None:
            groups.append([k])
        else:
            group.append(k)
    first = [group[0] for group in groups]
    bodies = (
        replace(body, modes=np.stack([body.modes[group].sum(axis=0) for group in groups]))
        for body in motion.bodies
    )
    combined = MotionTruth(
        motion.frequencies_hz[first], motion.gains[:, first], tuple(bodies), motion.magnified[first]
    )
    return combined, groups


def still_area(motion: MotionTruth) -> float:
    """Share of the surface area that no mode moves."""
    still = total = 0.0
    for body in motion.bodies:
        area = _vertex_areas(body.rest, body.faces)
        moves = (np.abs(body.modes) > 0).any(axis=(0, 2))
        total += float(area.sum())
        still += float(area[~moves].sum())
    return still / total if total else 0.0


def _vertex_areas(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A third of each triangle's area to each of its corners."""
    area = np.zeros(len(rest))
    if len(faces):
        a, b, c = (rest[faces[:, i]].astype(np.float64) for i in range(3))
        share = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
        for i in range(3):
            area += np.bincount(faces[:, i], share, minlength=len(rest))
    return area


def phasor_maps(seen: Seen, motion: MotionTruth) -> np.ndarray | None:
    """Phasors [K, H, W, 3] per pixel that fit the seen displacements best; None if that cannot be done.

    Least squares over the timesteps of `seen`. Two modes of equal gains (`together` adds them up), or fewer
    timesteps than unknowns, leave the split open; and from a camera that moves, a pixel sees one surface after
    another. A pixel that does not see one and the same surface at every timestep, at an edge, is NaN.
    """
    if not seen.fixed:
        return None
    gains = motion.gains[list(seen.timesteps)]
    used = np.concatenate([gains.real, -gains.imag], axis=1)  # [n, 2K]: Re(m g) = Re m Re g − Im m Im g
    present = _present_columns(motion)
    system = used[:, present]
    if not len(system) or np.linalg.matrix_rank(system, tol=1e-4 * np.abs(used).max()) < system.shape[1]:
        return None
    n, height, width, _ = seen.displacement.shape
    given = seen.displacement.reshape(n, -1).astype(np.float64)
    solved = np.linalg.pinv(system) @ given
    missed = np.linalg.norm((given - system @ solved).reshape(n, -1, 3), axis=-1).max(axis=0)
    several = missed > _ONE_SURFACE * np.linalg.norm(given.reshape(n, -1, 3), axis=-1).max(axis=0)
    solved.reshape(len(solved), -1, 3)[:, several] = np.nan
    unknowns = np.zeros((used.shape[1], solved.shape[1]))
    unknowns[present] = solved
    real, imaginary = np.split(unknowns.reshape(-1, height, width, 3), 2)
    return real + 1j * imaginary


def _present_columns(motion: MotionTruth) -> np.ndarray:
    """Which of the 2K unknowns Re m_k, Im m_k are not zero all over the scene."""
    real, imaginary = (
        np.array(
            [any(part(b.modes[k]).any() for b in motion.bodies) for k in range(len(motion.frequencies_hz))]
        )
        for part in (np.real, np.imag)
    )
    return np.flatnonzero(np.concatenate([real, imaginary]))


def track_point(dataset: Dataset, seen: Seen | None) -> Track | None:
    """The point that moves most: in the picture of `seen`, else among all vertices; None without truth."""
    if dataset.motion is None:
        return None
    motion, _ = together(dataset.motion)
    moving = max(motion.bodies, key=lambda b: np.abs(b.modes).max(initial=0.0), default=None)
    if moving is None or not moving.modes.size:
        return None
    view, pixel, where = "", (0, 0), f"a vertex of {moving.name}"
    phasors = phasor_maps(seen, motion) if seen is not None else None
    if seen is not None and phasors is not None:
        peak = np.nan_to_num(seen.peak, nan=-1.0)
        peak[np.isnan(phasors).any(axis=(0, -1))] = -1.0
        row, column = (int(i) for i in np.unravel_index(int(np.argmax(peak)), peak.shape))
        view, pixel = seen.view.name, (row, column)
        modes, where = phasors[:, row, column], f"what pixel ({column}, {row}) of {seen.view.name} sees"
    else:
        vertex = int(np.argmax(np.abs(moving.modes).sum(axis=(0, 2))))
        modes = moving.modes[:, vertex]
    displaced = (motion.gains @ modes).real
    axes = np.linalg.svd(displaced, full_matrices=False)[2]
    direction = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))] or 1.0)
    return Track(where, view, pixel, displaced, direction)


def spectrum(series: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and amplitudes of a series [T]: its discrete Fourier transform, no window."""
    n = len(series)
    amplitude = np.abs(np.fft.rfft(series)) / n
    amplitude[1 : (n + 1) // 2] *= 2
    return np.fft.rfftfreq(n, 1 / fps), amplitude


def parts_text(summary: ModeSummary) -> str:
    """The moving parts with their share of the amplitude, the first few named."""
    shown = [f"{name} ({100 * size / summary.amplitude:.0f} %)" for name, size in summary.parts[:_MOST_NAMES]]
    more = len(summary.parts) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")
