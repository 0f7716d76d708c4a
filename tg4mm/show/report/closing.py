"""The last sections: settings, what it cost, and the commands to repeat it."""

import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tg4mm.core.files import to_json
from tg4mm.core.pages.page import Commands, Section, Table, Text
from tg4mm.core.pages.svg import number, size_text
from tg4mm.run.preset import preset_of
from tg4mm.show.measure import Sensor
from tg4mm.show.report.summary import Material, clock

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


def program() -> str:
    """How a shell calls this program: by name where it is on PATH, else by the path beside this Python."""
    if shutil.which("tg4mm"):
        return "tg4mm"
    beside = shutil.which("tg4mm", path=str(Path(sys.executable).parent))
    return shlex.quote(beside) if beside else f"{shlex.quote(sys.executable)} -m tg4mm"


def commands_section(m: Material, sensors: Sequence[Sensor], asked_alpha: float | None) -> Section:
    """Commands that make all of this again, and what to do next, with this run's own paths and numbers."""
    run, alpha = str(m.run.path), f"{m.view.alpha:g}"
    band = [] if m.band is None else ["--band", *(f"{f:g}" for f in m.band)]
    named = [part for s in sensors for part in ("--sensor", str(s))]
    lines = [("Train again, the same way", [*_train(m), "--out", f"{run}_again"])]
    if m.measurement is not None:
        out = f"{run}_measured"
        lines.append(("Measure the sensors: CSV, UFF, plots, shapes", ["measure", run, *named, "--out", out]))
    if m.metrics:
        lines.append(("Compare with the ground truth", ["evaluate", run]))
    own = [] if asked_alpha is None else ["--alpha", alpha]
    lines.append(("Write this page again", ["report", run, *own, *band, *named]))
    if m.model.motion is not None:
        lines += _renderings(m, band)
    splat = "One splat file with the motion in it, for Blender and any splat viewer"
    lines.append((splat, ["export", run, "--format", "ply", "--out", f"{run}.ply"]))
    texts = [(what, f"{program()} {shlex.join(words)}") for what, words in lines]
    texts.insert(
        0, ("Next, as the run itself advises", f"{program()} {m.result.next_command.removeprefix('tg4mm ')}")
    )
    blender = Text(
        "In Blender, install the tg4mm extension and import the splat file with it: its panel in the sidebar has a "
        "slider for α, and the timeline plays the motion."
    )
    return Section("Commands to repeat it", [Commands(texts), blender])


def _renderings(m: Material, band: Sequence[str]) -> list[tuple[str, list[str]]]:
    run, alpha = str(m.run.path), f"{m.view.alpha:g}"
    words = ["render", run, "--alpha", alpha, *band]
    turn = [*words, "--orbit", "240", "--slow", "2", "--out", f"{run}_orbit"]
    lines = [("A camera that moves around the scene, at half speed", turn)]
    if m.view.split == "test":
        lines.insert(
            0, ("Pictures and videos of this magnification", [*words, "--out", f"{run}_x{alpha}_test"])
        )
    return lines


def _train(m: Material) -> list[str]:
    words = ["train", str(m.run.dataset)]
    if m.run.preset != "modal":
        words += ["--preset", m.run.preset]
    defaults = {stage: asdict(config) for stage, config in preset_of(m.run).defaults.items()}
    for name, value in _flat(m.run.settings):
        stage, _, key = name.partition(".")
        if to_json({key: defaults.get(stage, {}).get(key, value)}, "default") != {key: value}:
            words += ["--set", f"{name}={str(value).lower() if isinstance(value, bool) else value}"]
    return words


def settings_section(m: Material) -> Section:
    """What the run was trained with and what this page magnifies."""
    band = "every frequency" if m.band is None else f"{m.band[0]:g} to {m.band[1]:g} Hz"
    versions = ", ".join(f"{name} {value}" for name, value in m.run.config.get("versions", {}).items())
    rows = [
        ["preset", m.run.preset],
        *([name, _setting(value)] for name, value in _flat(m.run.settings)),
        ["α of this page", f"{m.view.alpha:g}"],
        ["band of this page", band],
        ["dataset", str(m.run.dataset)],
        ["trained with", versions or "–"],
    ]
    return Section(
        "Settings", [Table(["setting", "value"], rows, "Settings of the run and of this page.", left=9)]
    )


def _flat(settings: Mapping[str, Any]) -> list[tuple[str, Any]]:
    out = []
    for stage, values in settings.items():
        out += (
            [(f"{stage}.{k}", v) for k, v in values.items()]
            if isinstance(values, Mapping)
            else [(stage, values)]
        )
    return out


def _setting(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "–"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)
