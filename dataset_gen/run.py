"""Runs the work: splits it into ranges, gives each to a fresh process, shows progress, checks the result.

A fresh process per range keeps memory from growing over long runs, and a crash costs one range. Several
processes of one thread each beat one of several threads: at these sizes half of a picture's time is spent
preparing it, which Cycles does on one core.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TextIO

import numpy as np

from . import points, tree, truth
from .plan import Shot, shots
from .quality import Quality
from .scene import Scene
from .scenes import SCENES
from .settings import GenerateError, Settings

ENTRY = Path(__file__).with_name("blender_main.py")
RANGE = 300  # shots per process at most
DONE = "done"  # first word of the line a worker writes after each shot
POINT_VIEWS = ".points"  # working folder: colours that each training view gives to the points


class RunFailed(RuntimeError):
    """A worker died, or the set is not complete: not the user's input."""


def generate(settings: Settings, out: Path, processes: int = 0, stream: TextIO | None = None) -> Path:
    """Generates a dataset, or finishes one that a killed run left, and returns its folder.

    Parameters: `out`, the parent folder; `processes`, how many at once (0: one per core); `stream`, where
    progress goes (standard error). Raises GenerateError on bad input and RunFailed if rendering fails.
    """
    scene = scene_of(settings)
    versions = {"blender_version": _blender_version(), "package_version": _package_version()}
    _check_exr(settings)
    root = out / settings.folder
    tree.claim(root, tree.describe(settings, scene, Quality.of(settings).describe(), versions))
    tree.clean(root)
    every = shots(settings, scene.motion(settings.fps))
    tree.write_poses(root, settings)
    if not (root / "truth/motion.npz").exists():
        truth.write_motion(root / "truth/motion.npz", scene)
    wants_points = settings.points > 0 and not (root / "points3d.ply").exists()
    todo = [i for i, shot in enumerate(every) if not _finished(root, shot, settings, wants_points)]
    _render(settings, root, todo, processes or (os.cpu_count() or 1), stream or sys.stderr)
    if wants_points:
        _write_points(root, scene, settings, every)
    shutil.rmtree(root / POINT_VIEWS, ignore_errors=True)
    if missing := missing_files(root, settings, every):
        raise RunFailed(f"{root}: {len(missing)} files are missing or damaged, the first is {missing[0]}")
    return root


def scene_of(settings: Settings) -> Scene:
    """The description of the scene that the settings name. Raises GenerateError for an unknown name."""
    if settings.scene not in SCENES:
        raise GenerateError(f"scene {settings.scene!r} is none of {', '.join(sorted(SCENES))}")
    return SCENES[settings.scene](settings.frequency, settings.amplitude)


def missing_files(root: Path, settings: Settings, every: Sequence[Shot]) -> list[str]:
    """Files of the set, relative to its folder, that are absent or not whole."""
    names = [name for shot in every for name in (*shot.images, *shot.truth)]
    missing = [name for name in names if not tree.complete(root / name, settings.size, settings.size)]
    others = ["truth/motion.npz", *(["points3d.ply"] if settings.points else [])]
    return missing + [name for name in others if not (root / name).exists()]


def point_view(root: Path, shot: Shot) -> Path:
    """File of the colours that a training view gives to the points."""
    return root / POINT_VIEWS / f"{shot.camera.name}.npz"


def _finished(root: Path, shot: Shot, settings: Settings, wants_points: bool) -> bool:
    if wants_points and shot.sees_rest and not point_view(root, shot).exists():
        return False
    names = (*shot.images, *shot.truth)
    return all(tree.complete(root / name, settings.size, settings.size) for name in names)


def _write_points(root: Path, scene: Scene, settings: Settings, every: Sequence[Shot]) -> None:
    views = []
    for shot in every:
        if shot.sees_rest:
            with np.load(point_view(root, shot), allow_pickle=False) as data:
                views.append({name: data[name] for name in data.files})
    seen, colours = points.merge(views, settings.points)
    candidates = points.sample_surfaces(scene, settings.points, settings.seed)
    points.write_ply(root / "points3d.ply", candidates.positions[seen], candidates.normals[seen], colours)


def _ranges(todo: Sequence[int], processes: int) -> list[Sequence[int]]:
    """Neighbouring shots share a state, so ranges are cut where they lie: equal, and none above RANGE."""
    count = max(min(processes, len(todo)), -(-len(todo) // RANGE))
    edges = [len(todo) * i // count for i in range(count + 1)] if count else [0]
    return [todo[a:b] for a, b in pairwise(edges)]


def _render(settings: Settings, root: Path, todo: Sequence[int], processes: int, stream: TextIO) -> None:
    """Feeds the ranges to `processes` workers; a failed one stops the others."""
    if not todo:
        return
    ranges: queue.SimpleQueue[Sequence[int]] = queue.SimpleQueue()
    for part in _ranges(todo, processes):
        ranges.put(part)
    processes = min(processes, ranges.qsize())
    threads = max(1, (os.cpu_count() or 1) // processes)
    progress = _Progress(len(todo), stream)
    pool = _Pool(settings, root, threads, progress)
    try:
        with tempfile.TemporaryDirectory(prefix="dataset_gen_") as scratch:
            feeders = [
                threading.Thread(target=pool.feed, args=(ranges, Path(scratch) / f"{i}.json"))
                for i in range(processes)
            ]
            for feeder in feeders:
                feeder.start()
            for feeder in feeders:
                feeder.join()
    except BaseException:
        pool.stop()
        raise
    progress.close()
    if pool.failure:
        raise RunFailed(pool.failure)


class _Pool:
    """Worker processes and what became of them."""

    def __init__(self, settings: Settings, root: Path, threads: int, progress: _Progress) -> None:
        self._job = {"settings": settings.to_json(), "root": str(root.resolve()), "threads": threads}
        self._progress = progress
        self._running: set[subprocess.Popen[str]] = set()
        self.failure = ""

    def feed(self, ranges: queue.SimpleQueue[Sequence[int]], job_path: Path) -> None:
        """Takes ranges until there are none left; what goes wrong is kept in `failure`."""
        try:
            self._feed(ranges, job_path)
        except OSError as error:
            self.failure = self.failure or f"a render process could not be started: {error}"
            self.stop()

    def _feed(self, ranges: queue.SimpleQueue[Sequence[int]], job_path: Path) -> None:
        while not self.failure:
            try:
                part = ranges.get_nowait()
            except queue.Empty:
                return
            job_path.write_text(json.dumps({**self._job, "shots": list(part)}))
            self._run(job_path)

    def _run(self, job_path: Path) -> None:
        log_path = job_path.with_suffix(".log")
        with log_path.open("w") as log:
            process = subprocess.Popen(_command(job_path), stdout=subprocess.PIPE, stderr=log, text=True)
        self._running.add(process)
        assert process.stdout is not None
        for line in process.stdout:
            if line.strip() == DONE:
                self._progress.step()
        status = process.wait()
        self._running.discard(process)
        if status and not self.failure:
            last = log_path.read_text(errors="replace").strip().splitlines()[-1:] or ["no message"]
            self.failure = f"a render process ended with status {status}: {last[0]}"
            self.stop()

    def stop(self) -> None:
        """Ends all workers; what they finished stays."""
        self.failure = self.failure or "stopped"
        for process in list(self._running):
            process.terminate()


def _command(job_path: Path) -> list[str]:
    """How to start a worker: with Blender if this is Blender, else with this Python and pip's bpy."""
    bpy = sys.modules.get("bpy")
    binary = bpy.app.binary_path if bpy is not None else ""
    script = [str(ENTRY), "--", "--job", str(job_path)]
    if binary:
        return [binary, "--background", "--factory-startup", "--python-exit-code", "1", "--python", *script]
    return [sys.executable, *script]


class _Progress:
    """Pictures done and time left, on one line of a terminal or on a plain line every few seconds."""

    def __init__(self, total: int, stream: TextIO) -> None:
        self._total, self._stream = total, stream
        self._done, self._start, self._shown = 0, time.monotonic(), 0.0
        self._terminal = stream.isatty()
        self._lock = threading.Lock()

    def step(self) -> None:
        with self._lock:
            self._done += 1
            now = time.monotonic()
            if now - self._shown > (0.2 if self._terminal else 5.0) or self._done == self._total:
                self._shown = now
                self._show(now - self._start)

    def _show(self, elapsed: float) -> None:
        left = elapsed / self._done * (self._total - self._done)
        text = f"rendering {self._done}/{self._total}  {elapsed:.0f} s, {left:.0f} s left"
        self._stream.write(f"\r{text}   " if self._terminal else f"{text}\n")
        self._stream.flush()

    def close(self) -> None:
        if self._terminal:
            self._stream.write("\n")


def _blender_version() -> str:
    """Version of the Blender that will render, without importing it (that costs seconds) where possible."""
    if "bpy" in sys.modules:
        return ".".join(str(n) for n in sys.modules["bpy"].app.version)
    try:
        return importlib.metadata.version("bpy")
    except importlib.metadata.PackageNotFoundError:
        raise GenerateError(
            "bpy (Blender as a Python module) is not installed: pip install bpy, or run this with "
            "blender --background --python dataset_gen/blender_main.py -- …"
        ) from None


def _package_version() -> str:
    from tg4mm import __version__

    return __version__


def _check_exr(settings: Settings) -> None:
    if settings.truth != "none" and importlib.util.find_spec("OpenEXR") is None:
        raise GenerateError(
            "--truth needs the package OpenEXR, which this Python lacks: install it or use --truth none"
        )
