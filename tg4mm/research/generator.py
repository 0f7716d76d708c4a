"""The dataset generator in a process of its own, which Blender takes over."""

import importlib.util
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from dataset_gen.errors import blender_remedy
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.parent import ending_with_this


def run_generator(arguments: Sequence[str]) -> int:
    """Run `python -m dataset_gen` and return its exit code, 1 if it was killed.

    Raises Tg4mmError where it is not installed.
    """
    if importlib.util.find_spec("bpy") is None:
        raise Tg4mmError(f"generate needs the Python package bpy, which is not installed: {blender_remedy()}")
    if wrong := [text for text in arguments if "\0" in text]:
        raise Tg4mmError(f"generate: {wrong[0]!r} holds a null character, which no file name may contain")
    status = run_child([sys.executable, "-m", "dataset_gen", *arguments])
    if status < 0:
        print(
            f"tg4mm: the generator was ended by signal {-status}; run the same command again to continue",
            file=sys.stderr,
        )
        return 1
    return status


def run_child(command: Sequence[str]) -> int:
    """Run a program and return its exit status. A signal to this process alone ends it, too: KeyboardInterrupt.

    A program of ours ends as well where this process is killed.
    """
    with _passing_signals_on() as children, subprocess.Popen(command, env=ending_with_this()) as child:
        children.append(child)
        try:
            return child.wait()
        except KeyboardInterrupt:
            child.wait()  # it ends at a whole file
            raise


@contextmanager
def _passing_signals_on() -> Iterator[list[subprocess.Popen]]:
    """SIGTERM and SIGINT end the processes of the list, too: a scheduler sends them to this process alone.

    After a Ctrl+C at a terminal, which all of them got, the second signal does nothing.
    """
    children: list[subprocess.Popen] = []

    def stop(number: int, frame: FrameType | None) -> None:
        for child in children:
            child.terminate()
        raise KeyboardInterrupt

    # On Windows a process cannot be asked to end, and Ctrl+C reaches all of them.
    if sys.platform == "win32" or threading.current_thread() is not threading.main_thread():
        yield children
        return
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield children
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
