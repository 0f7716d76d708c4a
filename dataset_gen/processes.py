"""Render processes: a fresh one per range of pictures, fed and watched; progress with the time left."""

import contextlib
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from tg4mm.core.parent import ending_with_this
from tg4mm.core.progress import progress, say

from .errors import GenerateError
from .plan import RANGE, ranges
from .settings import Settings, Source

ENTRY = Path(__file__).with_name("blender_main.py")
DONE = "done"  # the line a worker writes after each shot
NOTE = "note "  # how a line begins that the user should see
REFUSED = 3  # exit status of a worker that found the user's input wrong; the last line of its log says how


class RunFailed(RuntimeError):
    """A render process died, or the set is not complete: not the user's input."""


def render(
    settings: Settings,
    root: Path,
    todo: Sequence[int],
    count: int,
    stream: TextIO,
    note: Callable[[int], None] = lambda done: None,
) -> None:
    """Renders the shots with these numbers in `count` processes at once; a failed one stops the others.

    `note` is called after each picture with the number completed.
    """
    if not todo:
        return
    pieces = max(min(count, len(todo)), -(-len(todo) // RANGE))
    waiting: queue.SimpleQueue[list[int]] = queue.SimpleQueue()
    for part in ranges(len(todo), pieces):
        waiting.put([todo[i] for i in part])
    count = min(count, pieces)
    job: dict[str, Any] = {"task": "render", "settings": settings.to_json(), "root": str(root.resolve())}
    job["threads"] = max(1, cores() // count)
    with progress("rendering", len(todo), "pictures", stream=stream) as update:

        def both(done: int) -> None:
            note(done)
            update(done)

        pool = _Pool(job, both)
        try:
            with tempfile.TemporaryDirectory(prefix="dataset_gen_") as scratch:
                feeders = [
                    threading.Thread(target=pool.feed, args=(waiting, Path(scratch) / f"{i}.json"))
                    for i in range(count)
                ]
                for feeder in feeders:
                    feeder.start()
                for feeder in feeders:
                    feeder.join()
        except BaseException:
            pool.stop()
            raise
        pool.raise_failure()


def cores() -> int:
    """Processor cores that this process may use, which on a cluster are fewer than there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def single(task: dict[str, Any], label: str) -> None:
    """One process for one task that is not rendering: looking into a user's file, saving an animation."""
    with (
        tempfile.TemporaryDirectory(prefix="dataset_gen_") as scratch,
        progress(label, 1, "file", brief=True) as update,
    ):
        path = Path(scratch) / "job.json"
        path.write_text(json.dumps(task))
        pool = _Pool({}, update)
        try:
            pool.run(path)
        except BaseException:
            pool.stop()
            raise
    pool.raise_failure()


def inspect(source: Source, found: Path) -> None:
    """Writes the bodies of a user's file to `found`. Raises GenerateError if the file is of no use."""
    single({"task": "inspect", "source": asdict(source), "found": str(found)}, f"reading {source.path}")


class _Pool:
    def __init__(self, job: dict[str, Any], update: Callable[[int], None]) -> None:
        self._job, self._update, self._done, self._counting = job, update, 0, threading.Lock()
        self._running: set[subprocess.Popen[str]] = set()
        self._failure = ""
        self._refused = False
        self._noted: set[str] = set()

    def feed(self, waiting: queue.SimpleQueue[list[int]], path: Path) -> None:
        """Takes ranges until there are none left; what goes wrong is kept."""
        try:
            for part in _drain(waiting):
                if self._failure:
                    return
                path.write_text(json.dumps({**self._job, "shots": part}), encoding="utf-8")
                self.run(path)
        except OSError as error:
            self._fail(f"a render process could not be started: {error}")

    def run(self, path: Path) -> None:
        """One process, to its end."""
        log_path = path.with_suffix(".log")
        with log_path.open("wb") as log:
            command = _command(path, self._job.get("threads", 0))
            process = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=log,
                encoding="utf-8",
                errors="replace",
                env=ending_with_this(),
            )
        self._running.add(process)
        if self._failure:  # all were ended while this one started
            process.terminate()
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith(NOTE):
                self._note(line.removeprefix(NOTE).strip())
            elif line.strip() == DONE:
                with self._counting:
                    self._done += 1
                    self._update(self._done)
        status = process.wait()
        self._running.discard(process)
        if status and not self._failure:
            last = log_path.read_text(errors="replace").strip().splitlines()[-1:] or ["no message"]
            self._refused = status == REFUSED
            self._fail(
                last[0] if self._refused else f"a render process ended with status {status}: {last[0]}"
            )

    def _note(self, note: str) -> None:
        """Once each: every worker finds the same."""
        if note not in self._noted:
            self._noted.add(note)
            say("note", note)

    def _fail(self, why: str) -> None:
        self._failure = self._failure or why
        self.stop()

    def stop(self) -> None:
        """Ends all workers; what they finished stays."""
        self._failure = self._failure or "stopped"
        for process in list(self._running):
            process.terminate()

    def raise_failure(self) -> None:
        """Raises what went wrong: GenerateError where the input is to blame, else RunFailed."""
        if self._failure:
            raise GenerateError(self._failure) if self._refused else RunFailed(self._failure)


def _drain(waiting: queue.SimpleQueue[list[int]]) -> Iterator[list[int]]:
    with contextlib.suppress(queue.Empty):
        while True:
            yield waiting.get_nowait()


def _command(job_path: Path, threads: int) -> list[str]:
    """Return the command that starts a worker: Blender if this is Blender, else this Python with pip's bpy.

    threads: size of the thread pool of Blender, 0 for all cores. Threads beyond those of Cycles would busy-wait and
    slow down the others.
    """
    bpy = sys.modules.get("bpy")
    binary = bpy.app.binary_path if bpy is not None else ""
    script, pool = [str(ENTRY), "--", "--job", str(job_path)], ["--threads", str(threads)]
    if binary:
        quiet = ["--background", "--factory-startup", "--python-exit-code", "1"]
        return [binary, *quiet, *pool, "--python", *script]
    return [sys.executable, *script, *pool]
