"""Load one file, several, or a numbered sequence as objects; if one fails, none is created."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import SplatFile, read_head, read_splat
from tg4mm.core.splatfile.drawable import Options

from ..nodes import scene

STILL = 1e-6  # of the largest motion: float32 holds no less beside it


@dataclass(frozen=True)
class Loaded:
    """The objects that an import created, and messages about them."""

    objects: list[Any]
    message: str
    fps: float  # Hz; 0.0 if no file says
    n_timesteps: int
    upright: bool = False  # the format says what is up, and it is up


def load(
    paths: Sequence[Path],
    collection: Any,
    sequences: bool,
    most: int,
    step: Callable[[float], None],
    options: Options = Options(),  # noqa: B008, frozen
) -> Loaded:
    """Import the chosen files into `collection`. `step(part)` is called as the work goes on, 0 to 1.

    With `sequences`, static files numbered alike play one after another, and a single one brings the run that
    it is part of. Raises SplatFileError for a file that cannot be read or for more than `most` Gaussians in
    all; then nothing is left behind.
    """
    heads = [read_head(path) for path in paths]
    moves = any(head.n_modes or (head.n_lost and options.freqs_hz) for head in heads)
    upright = all(head.y_up for head in heads)
    frames = _frames(paths) if sequences and not moves else None
    check_count(frames or paths, most)
    if frames is not None:
        return _load_sequence(frames, collection, step, options, upright)
    splats = []
    for i, path in enumerate(paths):
        splats.append(moving_modes(_read(path, options)))
        step((i + 1) / (len(paths) + 1))
    objects = scene.make_objects(splats, [path.stem for path in paths], collection)
    count, modes = sum(len(splat) for splat in splats), sum(splat.n_modes for splat in splats)
    longest = max(splats, key=lambda splat: splat.n_timesteps)
    message = f"{count:,} Gaussians, {modes} mode{'' if modes == 1 else 's'}"
    told = [f"{path.name}: {note}" for path, splat in zip(paths, splats, strict=True) for note in splat.notes]
    return Loaded(
        objects, "; ".join([message, *told]), longest.fps if modes else 0.0, longest.n_timesteps, upright
    )


def _read(path: Path, options: Options) -> SplatFile:
    return read_splat(path, options.freqs_hz, options.fps, options.decode)


def moving_modes(splat: SplatFile) -> SplatFile:
    """Drop modes without motion: below STILL times the largest displacement, rotations included."""
    size = splat.scales.max()
    reach = np.array(
        [
            np.abs(d).max(initial=0.0) + size * np.abs(r).max(initial=0.0)
            for d, r in zip(splat.displacement, splat.rotation, strict=True)
        ]
    )
    keep = reach > STILL * reach.max(initial=0.0)
    if keep.all():
        return splat
    return replace(
        splat,
        freqs_hz=splat.freqs_hz[keep],
        displacement=splat.displacement[keep],
        rotation=splat.rotation[keep],
        deviation=None if splat.deviation is None else splat.deviation[keep],
    )


def check_count(paths: Sequence[Path], most: int) -> None:
    """Raise SplatFileError if the files hold more than `most` Gaussians in total; only headers are read."""
    total = sum(read_head(path).count for path in paths)
    if total > most:
        what = f"{paths[0]}: holds" if len(paths) == 1 else f"{paths[0].parent}: {len(paths)} files hold"
        raise SplatFileError(f"{what} {total:,} Gaussians, more than Most Gaussians, {most:,}")


def _frames(paths: Sequence[Path]) -> list[Path] | None:
    run = run_around(paths[0]) if len(paths) == 1 else as_sequence(paths)
    return run if run is not None and len(run) > 1 else None


def _load_sequence(
    frames: list[Path], collection: Any, step: Callable[[float], None], options: Options, upright: bool
) -> Loaded:
    odd: list[Path] = []  # of which there was something to tell

    def read(path: Path) -> SplatFile:
        splat = _read(path, options)
        odd.extend([path] if splat.notes else [])
        if splat.n_modes:
            raise SplatFileError(
                f"{path}: contains motion, so it cannot be a frame of a sequence; import it alone"
            )
        return splat

    obj, most = scene.make_sequence(
        frames, name_of(frames), collection, read, lambda i: step((i + 1) / len(frames))
    )
    message = f"{len(frames)} frames of up to {most:,} Gaussians"
    if missing := missing_beside(frames[0]):
        message += f"; there is no file number {', '.join(map(str, missing[:4]))}"
    if odd:
        message += f"; {len(odd)} of them changed in reading, see the console: first {odd[0].name}"
    return Loaded([obj], message, 0.0, len(frames), upright)


_NUMBER = re.compile(r"^(?P<stem>.*?)(?P<number>\d+)$")


def stem_and_number(path: Path) -> tuple[str, int] | None:
    """Split `bell_0007.ply` into ("bell_", 7); return None if the stem does not end in digits."""
    found = _NUMBER.match(path.stem)
    return None if found is None else (found["stem"], int(found["number"]))


def as_sequence(paths: Sequence[Path]) -> list[Path] | None:
    """Return the paths sorted by number if they share one stem and differ in number, else None."""
    parts = [stem_and_number(path) for path in paths]
    known = [part for part in parts if part is not None]
    stems = {(path.parent, part[0]) for path, part in zip(paths, parts, strict=True) if part is not None}
    numbers = {part[1] for part in known}
    if len(paths) < 2 or len(known) < len(paths) or len(stems) > 1 or len(numbers) < len(paths):
        return None
    return [path for _, path in sorted(zip((n for _, n in known), paths, strict=True))]


def run_around(path: Path) -> list[Path]:
    """Return the gapless run of numbered files beside `path` that contains it.

    Only `path` itself where it has no number or no neighbour.
    """
    own = stem_and_number(path)
    if own is None:
        return [path]
    beside: dict[int, Path] = {}
    for other in sorted(path.parent.glob(f"*{path.suffix}")):
        part = stem_and_number(other)
        # Of `f_1` and `f_01` the one written as `path` is.
        if (
            part is not None
            and part[0] == own[0]
            and (part[1] not in beside or len(other.stem) == len(path.stem))
        ):
            beside[part[1]] = other
    beside[own[1]] = path
    first = last = own[1]
    while first - 1 in beside:
        first -= 1
    while last + 1 in beside:
        last += 1
    return [beside[i] for i in range(first, last + 1)]


def missing_beside(path: Path) -> list[int]:
    """Return the first number of every gap in the numbered files that share the stem of `path`."""
    own = stem_and_number(path)
    parts = map(stem_and_number, path.parent.glob(f"*{path.suffix}"))
    numbers = {part[1] for part in parts if own is not None and part is not None and part[0] == own[0]}
    return [n + 1 for n in sorted(numbers)[:-1] if n + 1 not in numbers]


def name_of(paths: Sequence[Path]) -> str:
    """Return a name for a sequence: its stem without the separator before the number."""
    part = stem_and_number(paths[0])
    return (part[0].rstrip("_-. ") if part else "") or paths[0].parent.name or "splats"
