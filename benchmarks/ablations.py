"""Ablations: one thing is varied at a time, by settings or by how the set is made; one table for each.

    python -m benchmarks ablations OUT [--names smoothness views] [--scene mic] [--alphas 20,50] [--options "--size 64"]

A row is a label with settings as of `tg4mm train --set`, options of `tg4mm generate`, or both. Sets and runs lie in
OUT; what is finished is not done again. Displacement error and leak are of the rms motion; SSIM at the largest α.
"""

import argparse
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import json_digest
from tg4mm.research.bench.means import scalars
from tg4mm.research.bench.measure import measure
from tg4mm.research.bench.request import BenchPlan, Training
from tg4mm.research.bench.sets import BenchSet, open_set
from tg4mm.research.evaluate.run import CEILING, STATIC
from tg4mm.research.generator import run_child
from tg4mm.research.text import shown

SLOW = "--frequency 3.4"  # Hz: no whole number of periods, as outside of generated data
# How a scene is filmed, as options of the generator; orbit is the reference, 30 views of 30 timesteps by default.
KINDS: dict[str, str] = {
    "orbit": "",
    "sweep": f"--cameras sweep --timesteps 90 {SLOW}",
    "handheld": f"--cameras handheld --timesteps 150 {SLOW}",
    "rig": f"--cameras rig --views 8 --clock-offsets 0.5 --timesteps 60 {SLOW}",
    "clips": f"--cameras clips --views 7 --timesteps 75 {SLOW}",
}


@dataclass(frozen=True)
class Row:
    """One variant: what differs from the preset and from the set as it is."""

    label: str
    settings: Mapping[str, str] = field(default_factory=dict)  # as `--set`
    data: str = ""  # options of `tg4mm generate`
    preset: str = "modal"


def _paper(label: str, **settings: str) -> Row:
    return Row(label, {f"paper.{key}": value for key, value in settings.items()}, preset="paper-tuned")


ABLATIONS: dict[str, tuple[Row, ...]] = {
    "initialisation": tuple(Row(kind, {"space.init": kind}) for kind in ("hull", "points", "sfm", "random")),
    "smoothness": (
        Row("found from the pictures"),
        # 0 stands for "found"; 1e-6 is as good as none: the smallest weight that was ever of use is 5.
        *(Row(w, {"motion.smoothness_weight": w}) for w in ("1e-6", "5", "50", "500", "5000")),
    ),
    "parts": (
        Row("all"),
        Row("every camera's own rotation is taken out", {"motion.nuisance": "all"}),
        Row("smoothness weight 3000", {"motion.smoothness_weight": "3000"}),
        Row("no sinusoids", {"motion.sinusoids": "false"}),
        Row("attenuation is left", {"motion.attenuation": "false"}),
    ),
    "views": tuple(Row(f"{n} cameras", data=f"--views {n}") for n in (3, 5, 10, 15, 20, 30)),
    "timesteps": tuple(Row(f"{n} timesteps", data=f"--timesteps {n}") for n in (6, 12, 18, 24, 30)),
    "noise": (
        Row("none"),
        *(Row(s, data=f"--sensor {s} --jpeg 0") for s in ("scientific", "high-speed", "phone")),
    ),
    "amplitude": tuple(
        Row(
            f"{px:g} px",
            data=f"--amplitude-px {px:g} --alphas " + ",".join(f"{t / px:.0f}" for t in (1, 2, 4, 8)),
        )
        for px in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
    ),
    "capture": tuple(Row(kind, data=options) for kind, options in KINDS.items()),
    "decoder": (
        _paper("decoder only", mlp_layers="0"),
        _paper("MLP 1 × 256", mlp_layers="1", mlp_width="256"),
        _paper("MLP 8 × 256", mlp_layers="8", mlp_width="256"),
    ),
    "residual": (_paper("with residual", residual="true"), _paper("without", residual="false")),
    "difference": (_paper("pictures (Eq. 16)", difference="false"), _paper("differences", difference="true")),
    "iterations": tuple(_paper(f"phase 2: {n}", motion_iterations=n) for n in ("20", "40", "80", "160")),
}
EFFECTS = {  # of a real camera, as options of the generator
    "shake": "--shake 0.5", "drift": "--exposure-drift 5", "flicker": "--flicker 2",
    "sensor": "--sensor phone --jpeg 0", "h264": "--codec h264",
}  # fmt: skip
ABLATIONS["effects"] = tuple(
    Row(name, data=f"--background white {options}")
    for name, options in (
        {"none": ""} | EFFECTS | {"jpeg": "--sensor phone", "all": " ".join(EFFECTS.values())}
    ).items()
)
OPTIONS: dict[str, Any] = {
    "out": Path,
    "--names": {"nargs": "+", "choices": list(ABLATIONS), "default": list(ABLATIONS)},
    "--scene": "mic",
    "--alphas": "20,50",
    "--options": "",
}
_COLUMNS = {  # of `scalars`
    "displacement_error": "{:.1%}", "static_leak": "{:.1%}", "amplitude_ratio": "{:.3f}",
    "direction_error_deg": "{:.1f}", "frequency_error_hz": "{:.3f}", "total_s": "{:.0f}",
}  # fmt: skip
_HEADER = "| varied | error | leak | amplitude | direction, ° | frequency, Hz | s | method | SSIM | still | ceiling |"


def run(options: argparse.Namespace) -> None:
    """Prints a table for each name; a row that fails says why in its place, and the rest goes on."""
    for name in options.names:
        print(f"\n{name}, {options.scene}\n\n{_HEADER}\n|---|{'---:|' * 10}", flush=True)
        for row in ABLATIONS[name]:
            try:
                for line in _lines(row, options):
                    print(line, flush=True)
            except Tg4mmError as error:
                print(f"| {row.label} | {error} |", flush=True)


def _lines(row: Row, options: argparse.Namespace) -> list[str]:
    """The row, a line for each way in which its preset is magnified."""
    data = _made(f"--alphas {options.alphas} {options.options} {row.data}", options)
    training = Training(row.preset, row.preset, row.settings)
    place = options.out / "runs" / json_digest([row.preset, dict(row.settings), data.digest])[:12]
    found = measure(place, data, training, BenchPlan())
    values = scalars(found)
    cells = [row.label, *(shown(values[key], form) for key, form in _COLUMNS.items())]
    scores = found["rows"][max(found["rows"], key=float)]
    framing = [shown(scores[name]["ssim"], "{:.4f}") for name in (STATIC, CEILING)]
    return [
        f"| {' | '.join([*cells, way.name, shown(scores[way.name]['ssim'], '{:.4f}'), *framing])} |"
        for way in training.ways
    ]


def _made(given: str, options: argparse.Namespace) -> BenchSet:
    """The set of these options of the generator, rendered unless it is there; a later option has the last word."""
    arguments = shlex.split(given)
    parent = options.out / "data" / json_digest([options.scene, *arguments])[:12]
    command = [sys.executable, "-m", "tg4mm", "generate", options.scene, "--out", str(parent), *arguments]
    if not any(parent.glob("*/report/index.html")) and run_child(command):
        raise Tg4mmError(f"tg4mm generate {options.scene} {given} failed")
    (root,) = (path.parent for path in parent.glob("*/scene.json"))
    return open_set(root, parent.name)
