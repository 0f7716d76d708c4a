"""Command line of the generator: `python -m dataset_gen SCENE --out DIR`; and what a file holds, for --list."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import numpy as np

from tg4mm.core.digits import aligned
from tg4mm.core.errors import Tg4mmError, system_says
from tg4mm.core.parent import end_with_parent
from tg4mm.core.progress import emit_event, events_wanted, print_any_text, say

from . import run
from .options import Request, parser, request_from
from .prepare import framed, inspected, motion_of
from .processes import RunFailed
from .scenes import NAMES
from .settings import Settings, Source, motion_file
from .vibration import Body, reach

if TYPE_CHECKING:
    from .sources.bodies_file import FileContents

_DIGITS = 4  # significant


def listing(source: Source, settings: Settings | None) -> str:
    """Lines for the terminal. `settings`: with a motion, whose amplitudes are listed, too.

    Raises GenerateError for a file, or a motion on it, that the generator would refuse.
    """
    found = inspected(source)
    lines = [*_about(found), "", *_table(found.bodies)]
    if settings is not None:
        lines += ["", *_modes(settings, found)]
    return "\n".join(lines)


def scenes_listed() -> str:
    """The built-in scenes, a line for each: its name and what moves in it, as its motion description begins."""
    lines = []
    for name in NAMES:
        first = motion_file(name).read_text(encoding="utf-8").splitlines()[0]
        lines.append(f"{name:10s} {first.removeprefix('# ')}")
    return "\n".join(lines)


def _about(found: FileContents) -> list[str]:
    vertices = sum(len(body.vertices) for body in found.bodies)
    unit, factor = found.own_unit
    scale = "the file does not say how long a scene unit is"
    if unit != "scene units":
        scale = f"1 scene unit is {_number(factor)} {unit}"
    cameras = ", ".join(found.camera_names) or "none"
    return [
        f"{len(found.bodies)} part{'' if len(found.bodies) == 1 else 's'}, {vertices:,} vertices",
        f"scale: {scale}; metres are {'' if found.unit_scale_m else 'not '}known",
        f"looked at: ({_place(found.centre)}), radius {_number(found.radius)} scene units",
        f"cameras of the file: {cameras}",
    ]


def _table(bodies: Sequence[Body]) -> list[str]:
    rows = [("part", "vertices", "box from", "to (scene units)", "vertex groups")]
    for body in bodies:
        low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
        groups = [name if weights.any() else f"{name} (empty)" for name, weights in body.groups.items()]
        row = (
            body.name, f"{len(body.vertices):,}", f"({_place(low)})", f"({_place(high)})", ", ".join(groups),
        )  # fmt: skip
        rows.append(row)
    return aligned(rows)


def _modes(settings: Settings, found: FileContents) -> list[str]:
    """Each mode's largest displacement in scene units, in the file's own unit and in pixels."""
    cameras = settings.cameras.placed(found.centre, found.radius, found.cameras)
    settings = framed(replace(settings, cameras=cameras), found.bodies)
    motion = motion_of(settings, found.bodies)
    lines = []
    for k, mode in enumerate(settings.motion.modes):
        most = max(float(reach(shape[k]).max(initial=0.0)) for shape in motion.shapes)
        per = " per second" if mode.frequency_hz == 0 else ""
        lines.append(
            f"mode {mode.name}: {mode.frequency_hz:g} Hz, up to {amplitude_text(most, found.own_unit)}{per}"
        )
    return lines


def amplitude_text(length: float, own_unit: tuple[str, float]) -> str:
    """A length in scene units, and in the file's own unit where it has another: "0.005 scene units = 1.2 mm"."""
    unit, factor = own_unit
    text = f"{_number(length)} scene units"
    return text if unit == "scene units" else f"{text} = {_number(length * factor)} {unit}"


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}"


def _place(position: Sequence[float] | np.ndarray) -> str:
    return ", ".join(_number(round(float(x), 6) + 0.0) for x in position)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the generator. Returns 0 done, 2 bad input (one line says what), 1 failed, 130 stopped."""
    print_any_text()
    with _stopped_once():
        end_with_parent()
        return _run(argv)


@contextlib.contextmanager
def _stopped_once() -> Iterator[None]:
    """SIGTERM, by which a scheduler stops jobs, is as Ctrl+C: the render processes end, too.

    So is SIGBREAK, by which Blender's panel asks on Windows. Further signals are ignored, so that nothing interrupts
    the ending.
    """

    def stop(number: int, frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    names = [name for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name)]
    before = {number: signal.signal(number, stop) for number in (getattr(signal, name) for name in names)}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None: set by Blender itself, which Python cannot do again.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _run(argv: Sequence[str] | None) -> int:
    try:
        options = parser().parse_args(argv)
        if options.list and not (options.scene or options.blend or options.mesh):
            print(scenes_listed())
            return 0
        request = request_from(options)
        if request.listed:
            print(listing(request.listed, request.sets[0] if request.sets else None))
            return 0
        for settings in request.sets:
            start = time.monotonic()
            word, path = _do(request, settings)
            if events_wanted():
                emit_event(word, path=str(path))
            else:
                print(f"{word}: {path}  ({time.monotonic() - start:.0f} s)", file=sys.stderr)
    except Tg4mmError as error:
        say("error", str(error), "error: ")
        return 2
    except (RunFailed, OSError) as error:
        said = system_says(error, named=True) if isinstance(error, OSError) else str(error)
        say("error", said, "error: ")
        return 1
    except KeyboardInterrupt:
        print("stopped; run the same command again to continue", file=sys.stderr)
        return 130
    return 0


def _do(request: Request, settings: Settings) -> tuple[str, Path]:
    if request.save_blend:
        return "saved", run.save_animation(settings, request.save_blend)
    if request.prepare:
        return "prepared", run.prepare_parts(settings, request.out, request.parts)
    if request.part:
        return "rendered", run.render_part(settings, request.out, request.part, request.count, sys.stderr)
    if request.finish:
        return "complete", run.finish_parts(settings, request.out, sys.stderr)
    if len(request.sets) > 1:
        print(f"{settings.scene}:", file=sys.stderr)
    return "complete", run.generate(settings, request.out, request.count)


if __name__ == "__main__":
    sys.exit(main())
