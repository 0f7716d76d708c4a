"""The same scenes from Blender 4.5 and 5.2: how far pictures and truth differ.

    python -m benchmarks blender_lines --other .venv52/bin/python [--scenes mic ship] [--size 128] [--samples 32]

This Python's bpy makes one set, the other Python's another; printed is what lies between them.
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dataset_gen import truth
from dataset_gen.scenes import NAMES

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Difference:
    """Between two sets of one scene."""

    largest: int  # grey levels of 255, over all pictures, pixels and channels
    mean: float  # grey levels
    share: float  # of pixels that differ in any channel
    passes: dict[str, float]  # largest difference of each data pass where both see a surface, its own units
    seen: float  # share of pixels where one sees a surface and the other none


def difference(one: Path, other: Path) -> Difference:
    """What lies between two finished sets of the same description."""
    from PIL import Image

    names = sorted(p.relative_to(one) for p in one.glob("**/r_*.png") if "report" not in p.parts)
    if not names or any(not (other / name).is_file() for name in names):
        raise ValueError(f"{one} and {other} do not hold the same pictures")
    steps = []
    for name in names:
        first, second = (np.asarray(Image.open(root / name)).astype(int) for root in (one, other))
        steps.append(np.abs(first - second))
    every = np.stack(steps)
    passes: dict[str, float] = {}
    seen = []
    for path in sorted(one.glob("truth/*/*/*.exr")):
        a, b = truth.read_exr(path), truth.read_exr(other / path.relative_to(one))
        both = (a["Depth"] < 1e9) & (b["Depth"] < 1e9)
        seen.append(((a["Depth"] < 1e9) != (b["Depth"] < 1e9)).mean())
        for key in a:
            apart = float(np.abs(a[key][both] - b[key][both]).max(initial=0.0))
            passes[key] = max(passes.get(key, 0.0), apart)
    return Difference(
        int(every.max()), float(every.mean()), float((every.max(-1) > 0).mean()), passes, float(np.mean(seen))
    )


def make(python: Path, scene: str, out: Path, size: int, samples: int) -> Path:
    """A small set by one Python's Blender. Raises RuntimeError with its last line if it fails."""
    options = (
        f"--size {size} --samples {samples} --timesteps 2 --views 1 --test-views 1 --alphas 50 --points 0"
    )
    command = [str(python), "-m", "dataset_gen", scene, "--out", str(out), *options.split()]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{python} on {scene}: {done.stderr.strip().splitlines()[-1]}")
    return next(path.parent for path in out.glob(f"{scene}_*/scene.json"))


OPTIONS = {
    "--other": {"type": Path, "required": True, "help": "Python with the other bpy"},
    "--scenes": {"nargs": "+", "default": list(NAMES), "choices": NAMES},
    "--size": 128,  # pixels
    "--samples": 32,  # light paths per pixel
}


def run(options: argparse.Namespace) -> None:
    """Print a row for each scene."""
    o = options
    print("| scene | largest, of 255 | mean | pixels that differ | depth | displacement | seen by one only |")
    print("|---|---|---|---|---|---|---|")
    for scene in o.scenes:
        with tempfile.TemporaryDirectory() as scratch:
            one = make(Path(sys.executable), scene, Path(scratch) / "a", o.size, o.samples)
            other = make(o.other.absolute(), scene, Path(scratch) / "b", o.size, o.samples)
            d = difference(one, other)
        print(
            f"| {scene} | {d.largest} | {d.mean:.4f} | {100 * d.share:.2f} % | {d.passes['Depth']:.1e} | "
            f"{d.passes['Displacement']:.1e} | {100 * d.seen:.2f} % |",
            flush=True,
        )
