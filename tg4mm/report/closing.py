"""The last sections: what it cost, and what to do next."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.report.page import Commands, Section, Table, Text
from tg4mm.report.summary import Material, clock
from tg4mm.report.svg import number

_SHOWN = {"seconds", "peak_memory_mib"}


def cost_section(m: Material, files: Mapping[str, Path]) -> Section:
    """Seconds and memory per stage, sizes on disk."""
    log = m.run.log()
    blocks: list[Table | Text] = [Text(f"The model has {len(m.model.gaussians):,} Gaussians{_modes(m)}.")]
    if log:
        rows = [_stage(name, figures) for name, figures in log.items()]
        blocks.append(
            Table(
                ["stage", "time", "peak memory", "figures"],
                rows,
                "Cost of each stage, from the run's log.",
                left=9,
            )
        )
    else:
        blocks.append(Text("The run's log holds no times."))
    sizes = [
        [label, size_text(size_on_disk(path)), str(path)] for label, path in files.items() if path.exists()
    ]
    blocks.append(Table(["what", "size", "where"], sizes, "Sizes on disk.", left=9))
    return Section("What it cost", blocks)


def _modes(m: Material) -> str:
    if m.model.motion is None:
        return ""
    n = len(m.model.motion.freqs_hz)
    return f", each with {n} complex mode{'s' if n != 1 else ''} of displacement and rotation"


def _stage(name: str, figures: Any) -> list[str]:
    figures = figures if isinstance(figures, dict) else {}
    seconds, memory = figures.get("seconds"), figures.get("peak_memory_mib")
    rest = [
        _figure(key, float(value))
        for key, value in figures.items()
        if key not in _SHOWN and isinstance(value, int | float) and not isinstance(value, bool)
    ]
    return [
        name,
        "–" if seconds is None else clock(float(seconds)),
        "–" if memory is None else f"{memory:,.0f} MiB",
        ", ".join(rest) or "–",
    ]


def _figure(key: str, value: float) -> str:
    if key == "explained_by_components":
        return f"these components hold {number(100 * value)} % of the changes in the images"
    text = f"{value:,.0f}" if value == round(value) and abs(value) < 1e12 else number(value, 4)
    words = key.removeprefix("n_").removesuffix("_db").replace("_", " ")
    if words.startswith("psnr"):
        return f"PSNR{words.removeprefix('psnr')} {text} dB"
    return f"{words} {text}"


def size_on_disk(path: Path) -> int:
    """Bytes of a file, or of all files of a folder; one with several names (hard links) counts once."""
    if path.is_file():
        return path.stat().st_size
    stats = [p.stat() for p in path.rglob("*") if p.is_file()]
    return sum({(s.st_dev, s.st_ino): s.st_size for s in stats}.values())


def size_text(size: int) -> str:
    """Bytes as 12.3 kB, 4.56 MB (powers of ten)."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{number(size / factor)} {unit}"
    return f"{size} B"


def total_seconds(log: Mapping[str, Any]) -> float | None:
    """Seconds of all stages of a run's log, None if none says."""
    found = [
        v["seconds"]
        for v in log.values()
        if isinstance(v, dict) and isinstance(v.get("seconds"), int | float)
    ]
    return float(sum(found)) if found else None


def program() -> str:
    """How a shell calls this program: by name where it is on PATH, else by the path beside this Python."""
    if shutil.which("tg4mm"):
        return "tg4mm"
    beside = shutil.which("tg4mm", path=str(Path(sys.executable).parent))
    return shlex.quote(beside) if beside else f"{shlex.quote(sys.executable)} -m tg4mm"


def next_section(m: Material) -> Section:
    """Commands to copy, with this run's own paths and numbers."""
    run, tg4mm = shlex.quote(str(m.run.path)), program()
    if m.model.motion is None:
        lines = [
            ("Render the static model on an orbit", f"{tg4mm} render {run} --alpha 0 --orbit 120 --out orbit")
        ]
    else:
        frequency = float(m.model.motion.freqs_hz[m.model.main])
        low, high = _narrow_band(m.model.motion.freqs_hz, m.model.main, m.model.motion.fps)
        lines = [
            (
                "Another magnification, from the test cameras",
                f"{tg4mm} render {run} --alpha 50 --out render_x50",
            ),
            (
                f"Only what moves near {number(frequency)} Hz",
                f"{tg4mm} render {run} --alpha {m.view.alpha:g} --band {low:g} {high:g} --out render_band",
            ),
            (
                "A camera that moves around the scene, at half speed",
                f"{tg4mm} render {run} --alpha {m.view.alpha:g} --orbit 240 --slow 2 --out render_orbit",
            ),
        ]
    lines += [
        (
            "One splat file with the motion in it, for Blender and any splat viewer",
            f"{tg4mm} export {run} --format ply --out splat.ply",
        ),
        (
            "Train on data of your own (a folder per timestep, scene.json with fps)",
            f"{tg4mm} train DATASET --out RUN",
        ),
    ]
    blender = Text(
        "In Blender, install the tg4mm extension and import splat.ply with it: its panel in the sidebar "
        "has a "
        "slider for α, and the timeline plays the motion."
    )
    return Section("What to do next", [Commands(lines), blender])


def _narrow_band(freqs: np.ndarray, main: int, fps: float) -> tuple[float, float]:
    """A band that holds frequency `main` and no other, within what `check_band` allows."""
    here = float(freqs[main])
    gaps = [abs(float(f) - here) for i, f in enumerate(freqs) if i != main and f != here]
    half = min([*gaps, 1.0]) / 2
    return max(0.0, round(here - half, 3)), min(round(here + half, 3), round(0.499 * fps, 3))
