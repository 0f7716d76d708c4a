"""Numbered files that are one animated object: which belong together, and the motion of Gaussians that they share."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import SplatFile
from tg4mm.core.splatfile.read import ENDINGS

from ..nodes.colours import C0

# Files share their Gaussians if sizes, colours and opacities differ, rms over the Gaussians, by less than this part of
# what they differ by among each other. In another order it is the square root of 2.
ALIKE, LEAST = 0.1, 1e-3
SEEN = 1 / 255  # a change of opacity, colour or (as a part) size that a picture of 8 bits may show
# Modes are kept until they hold this part of the motion's power: what is left is a hundredth of the motion. With fewer
# than ENOUGH, three hundredths, the files are played.
WHOLE, ENOUGH = 1 - 1e-4, 1 - 1e-3
MEANS = 3  # passes to the mean rotation; each leaves a small part of what is off
MOST_MODES, MOST_PHASORS = 64, 8_000_000  # a tree's time, and 450 MB

_NUMBER = re.compile(r"^(.*?)(\d+)$")


def stem_and_number(path: Path) -> tuple[str, int] | None:
    """Split `bell_0007.ply` or `bell_0007.compressed.ply` into ("bell_", 7); None if the stem ends in no digits."""
    found = _NUMBER.match(path.stem.removesuffix(".compressed"))
    return None if found is None else (found[1], int(found[2]))


def as_sequence(paths: Sequence[Path]) -> list[Path] | None:
    """Return the frames in the order of their numbers: several files numbered alike, or the gapless run around one.

    None if the files are no sequence.
    """
    own = stem_and_number(paths[0])
    if own is None:
        return None
    known = siblings(paths[0]) if len(paths) == 1 else _by_number(paths[0], paths)
    if len(paths) > 1:
        return [known[number] for number in sorted(known)] if len(known) == len(paths) else None
    first = last = own[1]
    while first - 1 in known:
        first -= 1
    while last + 1 in known:
        last += 1
    return [known[number] for number in range(first, last + 1)] if last > first else None


def siblings(path: Path) -> dict[int, Path]:
    """Return the files of the same folder, stem and suffix by number; of `f_1` and `f_01` the one written as `path`."""
    beside = sorted(path.parent.glob(f"*{path.suffix}"), key=lambda p: (len(p.stem) == len(path.stem), p))
    return _by_number(path, [*beside, path])


def _by_number(like: Path, paths: Sequence[Path]) -> dict[int, Path]:
    own, parts = stem_and_number(like), [(stem_and_number(path), path) for path in paths]
    same = [(part[1], path) for part, path in parts if part and own and part[0] == own[0]]
    return {number: path for number, path in same if path.parent == like.parent}


def missing_beside(path: Path) -> list[int]:
    """Return the first number of every gap in the numbered files that share the stem of `path`."""
    numbers = sorted(siblings(path))
    return [n + 1 for n in numbers[:-1] if n + 1 not in numbers]


def name_of(paths: Sequence[Path]) -> str:
    """Return a name for a sequence: its stem without the separator before the number."""
    part = stem_and_number(paths[0])
    return (part[0].rstrip("_-. ") if part else "") or paths[0].parent.name or "splats"


def of_folder(folder: Path) -> list[Path]:
    """Return the numbered files of a folder, in order. Raises SplatFileError if it has none, or several runs."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in ENDINGS and path.is_file())
    runs = {(part[0], path.suffix) for path in files if (part := stem_and_number(path))}
    if len(runs) != 1:
        what = (
            "no numbered splat files" if not runs else f"{len(runs)} numbered sequences: choose a file of one"
        )
        raise SplatFileError(f"{folder}: holds {what}")
    return [path for path in files if stem_and_number(path)]


def as_motion(splats: Iterable[SplatFile], count: int, fps: float) -> SplatFile | None:
    """Return static frames that share their Gaussians as one file with modes, those of the discrete Fourier transform.

    At timestep t it is frame t, but for a hundredth of the motion; after the last comes the first. `count`: of frames;
    `fps`: Hz. None where counts, sizes, colours or opacities differ, where nothing moves, or with too many modes.
    Sizes, colours and opacities stay those of the first frame; a note says which of them change visibly.
    """
    first, means, quats = None, np.empty(0, np.float32), np.empty(0, np.float32)
    changes: dict[str, float] = {}
    for t, splat in enumerate(splats):
        if first is None:
            first = splat
            means, quats = (np.empty((count, len(first), width), np.float32) for width in (3, 4))
        if not _share(first, splat, changes):
            return None
        means[t], quats[t] = splat.means, splat.quats
    if first is None or count < 2:
        return None
    rest = first.quats
    for _ in range(MEANS):
        turns = np.array([_turns(rest, after) for after in quats], np.float32)
        rest = _turned(turns.mean(axis=0), rest)
    moved, turned, size = _modes(means), _modes(turns), first.scales.max(axis=1)[:, None]
    power = (np.abs(moved[1:]) ** 2 + np.abs(size * turned[1:]) ** 2).sum(axis=(1, 2), dtype=float)
    order = np.argsort(-power, kind="stable")
    held = np.cumsum(power[order]) / (power.sum() or 1.0)
    n = min(1 + int(np.searchsorted(held, WHOLE)), len(order), MOST_MODES, MOST_PHASORS // len(first))
    if n < 1 or not power.any() or held[n - 1] < ENOUGH:
        return None
    kept = 1 + np.sort(order[:n])
    return replace(
        first,
        means=moved[0].real,
        quats=rest,
        freqs_hz=kept * fps / count,
        displacement=moved[kept],
        rotation=turned[kept],
        fps=fps,
        n_timesteps=count,
        notes=tuple(
            f"{name} stay as in the first file, though they change by up to {change:.0%}: without Find Motion they play"
            for name, change in changes.items()
            if change > SEEN
        ),
    )


def _share(a: SplatFile, b: SplatFile, changes: dict[str, float]) -> bool:
    """Return whether two frames hold the same Gaussians; raise `changes` to the largest change of each attribute."""
    if len(a) != len(b) or a.sh.shape != b.sh.shape:
        return False
    for name, unit, x, y in (
        ("opacities", 1.0, a.opacities, b.opacities),
        ("sizes", 1.0, np.log(np.maximum(a.scales, 1e-12)), np.log(np.maximum(b.scales, 1e-12))),
        ("colours", C0, a.sh, b.sh),
    ):
        change = np.abs(x - y)
        if np.sqrt((change**2).mean(axis=0)).max() > ALIKE * x.std(axis=0).max() + LEAST:
            return False
        changes[name] = max(changes.get(name, 0.0), unit * float(change.max(initial=0.0)))
    return True


def _modes(values: np.ndarray) -> np.ndarray:
    """[T, N, 3] over time → [1 + T // 2, N, 3] complex64: the mean, then m_k with x_t = Σ Re[m_k exp(i2πkt/T)]."""
    count = len(values)
    out = np.empty((1 + count // 2, *values.shape[1:]), np.complex64)
    for rows in np.array_split(np.arange(values.shape[1]), 1 + values[0].size * count // 10_000_000):
        out[:, rows] = np.fft.rfft(values[:, rows], axis=0) * (2 / count)
    out[0] /= 2
    if count % 2 == 0:
        out[-1] /= 2
    return out


def _turns(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Rotation vectors [N, 3], radians, world axes, from quaternions [N, 4] to others."""
    a, b = (q.astype(float) / np.linalg.norm(q, axis=1, keepdims=True) for q in (before, after))
    w = (a * b).sum(axis=1)
    v = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(b[:, 1:], a[:, 1:])
    v, w = v * np.where(w < 0, -1, 1)[:, None], np.abs(w)
    sine = np.linalg.norm(v, axis=1)
    return np.asarray(v * (2 * np.arctan2(sine, w) / np.maximum(sine, 1e-12))[:, None])


def _turned(turns: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """exp(turn)·q, [N, 4] float32, of rotation vectors [N, 3] and quaternions."""
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    w, v = np.cos(angle / 2), turns * (np.sinc(angle / (2 * np.pi)) / 2)
    q = quats.astype(float)
    real = w * q[:, :1] - (v * q[:, 1:]).sum(axis=1, keepdims=True)
    return np.concatenate([real, w * q[:, 1:] + q[:, :1] * v + np.cross(v, q[:, 1:])], axis=1).astype(
        np.float32
    )
