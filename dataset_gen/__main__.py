"""Command line: `python -m dataset_gen SCENE --out DIR …`, the same arguments as `tg4mm generate`."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

from tg4mm.core import events
from tg4mm.core.errors import Tg4mmError

from . import run
from .listing import listing, scenes_listed
from .options import Request, parser, request_from
from .processes import RunFailed
from .settings import Settings


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the generator. Returns 0 done, 2 bad input (one line says what), 1 failed, 130 stopped."""
    events.print_any_text()
    with _stopped_once():
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
            if events.wanted():
                events.emit(word, path=str(path))
            else:
                print(f"{word}: {path}  ({time.monotonic() - start:.0f} s)", file=sys.stderr)
        if len(request.sets) > 1 and not (request.prepare or request.part):
            print(f"overview: {run.overview(request.out)}", file=sys.stderr)
    except Tg4mmError as error:
        events.say("error", str(error), "error: ")
        return 2
    except (RunFailed, OSError) as error:
        events.say("error", str(error), "error: ")
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
