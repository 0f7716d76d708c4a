"""Seconds of an import and milliseconds a frame of the Blender extension, in the bpy that runs this.

python benchmarks/blender.py [--counts 10000,50000,200000] [--modes 8] [--degree 3] [--frames 15]

Frames are evaluated in background: node tree and instances, no drawing. The machine may be shared, so the least
of several is printed beside the median.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tg4mm.splatfile import SplatFile, write_splat  # noqa: E402

SHOWN = (  # Draw As, Colour By
    ("Ellipsoids", "File"),
    ("Ellipsoids", "Amplitude"),
    ("Ellipsoids", "Phase"),
    ("Splats", "File"),
    ("Points", "File"),
    ("Arrows", "File"),
)


def load(name: str, file: Path, folder: Path | None = None) -> ModuleType:
    """Import one file as the module `name`; with `folder`, as a package."""
    places = None if folder is None else [str(folder)]
    spec = importlib.util.spec_from_file_location(name, file, submodule_search_locations=places)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def random_splat(n: int, modes: int, degree: int) -> SplatFile:
    """Gaussians in a cloud, all of which move and turn in every mode."""
    rng = np.random.default_rng(0)

    def phasors(size: float) -> np.ndarray:
        return (size * (rng.normal(size=(modes, n, 3)) + 1j * rng.normal(size=(modes, n, 3)))).astype(
            np.complex64
        )

    return SplatFile(
        means=rng.normal(size=(n, 3)).astype(np.float32),
        quats=rng.normal(size=(n, 4)).astype(np.float32),
        scales=rng.uniform(0.001, 0.02, (n, 3)).astype(np.float32),
        opacities=rng.uniform(0, 1, n).astype(np.float32),
        sh=rng.normal(0, 0.2, (n, (degree + 1) ** 2, 3)).astype(np.float32),
        freqs_hz=1.0 + np.arange(modes),
        displacement=phasors(0.01),
        rotation=phasors(0.01),
        fps=60.0,
        n_timesteps=120,
    )


def frame_times(frames: int) -> tuple[float, float]:
    """Least and median milliseconds of evaluating a frame, after one that is not counted."""
    times = []
    for frame in range(1, frames + 2):
        start = time.perf_counter()
        bpy.context.scene.frame_set(frame)
        times.append((time.perf_counter() - start) * 1e3)
    return min(times[1:]), statistics.median(times[1:])


def import_seconds(path: Path) -> float:
    """Time of the import operator, file reading included."""
    start = time.perf_counter()
    bpy.ops.import_scene.tg4mm_splat(filepath=str(path))
    return time.perf_counter() - start


def measure(extension: ModuleType, path: Path, frames: int) -> None:
    """Import a file three times, then evaluate it in every way of showing it."""
    seconds = []
    for _ in range(3):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        seconds.append(import_seconds(path))
    obj: Any = bpy.context.object
    modifier = extension.scene.splat_modifier(obj)
    put = extension.compat.set_input
    put(modifier, extension.names.ALPHA, 3.0)
    print(f"  import {min(seconds):.2f} s, {path.stat().st_size / 2**20:.0f} MiB")
    rows = [(draw, colour, False) for draw, colour in SHOWN]
    if extension.compat.has_input(modifier, extension.names.VIEW_COLOUR):
        rows.append(("Ellipsoids", "File", True))
    for draw, colour, view in rows:
        put(modifier, extension.names.DRAW, draw)
        put(modifier, extension.names.COLOUR_BY, colour)
        if view:
            put(modifier, extension.names.VIEW_COLOUR, True)
        least, median = frame_times(frames)
        name = "view-dependent" if view else colour
        print(f"  {draw:10s} {name:14s} {least:6.1f} ms  (median {median:.1f})", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--counts", default="10000,50000,200000", help="Gaussians, separated by commas")
    parser.add_argument("--modes", type=int, default=8)
    parser.add_argument("--degree", type=int, default=3, help="of the spherical harmonics")
    parser.add_argument("--frames", type=int, default=15)
    options = parser.parse_args()
    load_average = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    print(f"bpy {bpy.app.version_string}, {options.modes} modes, degree {options.degree}, {load_average}")
    with tempfile.TemporaryDirectory() as folder:
        builder = load("make_extension", ROOT / "addon" / "make_extension.py")
        staged = builder.stage(Path(folder) / "tg4mm_extension")
        extension = load("tg4mm_extension", staged / "__init__.py", staged)
        extension.register()
        for count in map(int, options.counts.split(",")):
            path = Path(folder) / f"n{count}.ply"
            write_splat(path, random_splat(count, options.modes, options.degree))
            print(f"{count:,} Gaussians")
            measure(extension, path, options.frames)
        extension.unregister()


if __name__ == "__main__":
    main()
