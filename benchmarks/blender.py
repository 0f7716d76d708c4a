"""Seconds of an import and milliseconds a frame of the Blender extension, in the bpy that runs this.

python -m benchmarks blender [--counts 10000,50000,200000] [--modes 8] [--degree 3] [--frames 15] [--draw 0] [--brief]

Frames are evaluated in background: node tree and instances. `--draw N` also draws each with Workbench at N×N pixels,
which without a graphics card is software's work. Where Blender has splats of its own, its own import of the Gaussians
standing still is measured beside ours. Memory is what the process grew by at an import: run a large count alone.
`--brief`: the ways to draw in the file's colours alone. On a machine that is shared wall time includes the waiting for
others, so the least of several is printed beside the median, and the least processor time, all threads added up, beside
both. The goals: a frame of 50,000 Gaussians in under 20 ms in every way of showing them but Solid view's, which is for
small sets; an import of 200,000 in under 2 s.
"""

import argparse
import contextlib
import importlib
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np

from tg4mm.core.splatfile import SplatFile, write_splat

ROOT = Path(__file__).resolve().parent.parent

FRAME_GOAL = 50_000, 20.0  # Gaussians, ms
IMPORT_GOAL = 200_000, 2.0  # Gaussians, s
SMALL = 10_000  # Gaussians; with more Solid view's colours are not meant to be shown
SHOWN = (  # Draw As, Colour By
    ("Ellipsoids", "File"),
    ("Ellipsoids", "Amplitude"),
    ("Ellipsoids", "Phase"),
    ("Splats", "File"),
    ("Splats", "Phase"),
    ("Points", "File"),
    ("Points", "Phase"),
    ("Arrows", "File"),
    ("Native", "File"),
    ("Native", "Phase"),
)


def random_splat(n: int, modes: int, degree: int) -> SplatFile:
    """Gaussians in a cloud, all of which move and turn in every mode."""
    rng = np.random.default_rng(0)

    def phasors(size: float) -> np.ndarray:
        return (size * (rng.normal(size=(modes, n, 3)) + 1j * rng.normal(size=(modes, n, 3)))).astype(
            np.complex64
        )

    return SplatFile(
        means=rng.normal(size=(n, 3)).astype(np.float32), quats=rng.normal(size=(n, 4)).astype(np.float32),
        scales=rng.uniform(0.001, 0.02, (n, 3)).astype(np.float32),
        opacities=rng.uniform(0, 1, n).astype(np.float32),
        sh=rng.normal(0, 0.2, (n, (degree + 1) ** 2, 3)).astype(np.float32), freqs_hz=1.0 + np.arange(modes),
        displacement=phasors(0.01), rotation=phasors(0.01), fps=60.0, n_timesteps=120,
    )  # fmt: skip


class Times:
    """What something took, several times: wall and processor seconds of each."""

    def __init__(self) -> None:
        self.wall: list[float] = []
        self.cpu: list[float] = []

    def add(self, action: Callable[[], Any]) -> None:
        """Do something and note what it took."""
        wall, cpu = time.perf_counter(), time.process_time()
        action()
        self.wall.append(time.perf_counter() - wall)
        self.cpu.append(time.process_time() - cpu)

    def line(self, factor: float, unit: str, goal: float | None) -> str:
        """Least and median wall time, least processor time, and whether the least wall time is below the goal."""
        least, median, cpu = (
            factor * t for t in (min(self.wall), statistics.median(self.wall), min(self.cpu))
        )
        reached = "" if goal is None else f"  {'below' if least < goal else 'ABOVE'} {goal:g} {unit}"
        return f"{least:7.2f} {unit}  (median {median:.2f}, processor {cpu:.2f}){reached}"


def frame_times(frames: int) -> Times:
    """Evaluating a frame, after one that is not counted."""
    times = Times()
    bpy.context.scene.frame_set(1)
    for frame in range(2, frames + 2):
        times.add(lambda frame=frame: bpy.context.scene.frame_set(frame))
    return times


def resident_mib() -> float:
    """Memory of this process, MiB; Linux."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def measure(extension: ModuleType, path: Path, count: int, options: argparse.Namespace) -> None:
    """Import a file three times, then evaluate it, and draw it if asked, in every way of showing it."""
    times, before = Times(), resident_mib()
    for _ in range(3):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        times.add(lambda: bpy.ops.import_scene.tg4mm_splat(filepath=str(path)))
    goal = IMPORT_GOAL[1] if count == IMPORT_GOAL[0] else None
    grown = f"memory {resident_mib() - before:.0f} MiB"
    print(f"  {'import':25s} {times.line(1.0, 's', goal)}, {path.stat().st_size / 2**20:.0f} MiB, {grown}")
    obj: Any = bpy.context.object
    modifier, names = extension.nodes.scene.splat_modifier(obj), extension.names
    put = extension.compat.set_input
    put(modifier, names.ALPHA, 3.0)
    rows = [(draw, colour, "") for draw, colour in SHOWN if colour == "File" or not options.brief]
    if extension.compat.has_input(modifier, names.VIEW_COLOUR) and not options.brief:
        rows.append(("Ellipsoids", "File", names.VIEW_COLOUR))
    if count <= SMALL:
        rows += [("Ellipsoids", "File", names.SOLID_COLOUR), ("Points", "File", names.SOLID_COLOUR)]
    for draw, colour, extra in rows:
        if draw == "Native" and not extension.compat.native_splats():
            continue
        put(modifier, names.DRAW, draw)
        put(modifier, names.COLOUR_BY, colour)
        if extra:
            put(modifier, extra, True)
        label = {names.VIEW_COLOUR: "view-dependent", names.SOLID_COLOUR: "Solid view"}.get(extra, colour)
        goal = FRAME_GOAL[1] if count == FRAME_GOAL[0] else None
        print(f"  {draw:10s} {label:14s} {frame_times(options.frames).line(1e3, 'ms', goal)}", flush=True)
        if options.draw:
            print(f"  {'':10s} {'drawn':14s} {drawn_times(options.draw).line(1e3, 'ms', None)}", flush=True)
        if extra:
            put(modifier, extra, False)


def drawn_times(size: int) -> Times:
    """Evaluating a frame and drawing it with Workbench, after one that is not counted, in `size`² pixels."""
    scene, times = bpy.context.scene, Times()
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        scene.camera.location = 0.0, 0.0, 10.0
        scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.display.render_aa = "BLENDER_WORKBENCH", "OFF"
    scene.render.resolution_x = scene.render.resolution_y = size
    for frame in range(1, 5):
        scene.frame_set(frame)
        bpy.ops.render.render()
        if frame > 1:
            times.add(lambda frame=frame: (scene.frame_set(frame + 4), bpy.ops.render.render()))
    return times


def measure_own(path: Path) -> None:
    """Blender's own import of a file of splats that stand still."""
    times, before = Times(), resident_mib()
    for _ in range(3):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        times.add(lambda: bpy.ops.wm.ply_import(filepath=str(path)))
    grown = f"memory {resident_mib() - before:.0f} MiB"
    print(f"  {'its own import, still':25s} {times.line(1.0, 's', None)}, {grown}", flush=True)


OPTIONS = {
    "--counts": "10000,50000,200000",  # Gaussians
    "--modes": 8,
    "--degree": {"type": int, "default": 3, "help": "of the spherical harmonics"},
    "--frames": 15,
    "--draw": {"type": int, "default": 0, "help": "pixels along a side; 0: evaluate alone"},
    "--brief": {"action": "store_true", "help": "the file's colours alone"},
}


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    load_average = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    print(f"bpy {bpy.app.version_string}, {options.modes} modes, degree {options.degree}, {load_average}")
    with tempfile.TemporaryDirectory() as folder, registered() as extension:
        for count in map(int, options.counts.split(",")):
            path, still = Path(folder) / f"n{count}.ply", Path(folder) / f"s{count}.ply"
            splat = random_splat(count, options.modes, options.degree)
            write_splat(path, splat)
            write_splat(
                still, SplatFile.static(splat.means, splat.quats, splat.scales, splat.opacities, splat.sh)
            )
            print(f"{count:,} Gaussians")
            if extension.compat.native_splats():
                measure_own(still)
            measure(extension, path, count, options)


@contextlib.contextmanager
def registered() -> Iterator[ModuleType]:
    """The extension, registered over an empty file."""
    extension = importlib.import_module("addon")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    extension.register()
    yield extension
    extension.unregister()
