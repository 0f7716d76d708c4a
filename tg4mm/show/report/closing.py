"""The report's last sections: accuracy, settings, cost, and the commands to repeat it."""

import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.digits import number, size_text
from tg4mm.core.files import to_json
from tg4mm.core.pages.charts import CEILING, OURS, STILL, chart, colour_bar
from tg4mm.core.pages.page import Block, Commands, Figure, Section, Table, Text, drawing, picture
from tg4mm.run.preset import preset_of
from tg4mm.show.maps import difference_maps
from tg4mm.show.measure import Sensor
from tg4mm.show.report.figures import map_picture
from tg4mm.show.report.summary import Material, both_lengths, clock
from tg4mm.show.result.model import unit_of

_METHODS = (
    ("nothing moves", "still", STILL),
    ("ours", "ours", OURS),
    ("ceiling", "ceiling", CEILING),
)  # CSS class
_SCORES = (
    ("psnr_db", "PSNR (dB) ↑", ".2f"),
    ("ssim", "SSIM ↑", ".4f"),
    ("flip", "FLIP ↓", ".4f"),
    ("lpips", "LPIPS ↓", ".4f"),
)
_SHOWN = {"seconds", "peak_memory_mib"}


def accuracy_section(m: Material) -> list[Section]:
    """Return scores beside their two references, difference maps, displacement error; [] without ground truth."""
    if not m.metrics:
        return []
    blocks: list[Block] = []
    scored = [entry for entry in m.metrics["alphas"] if entry["rows"]]
    if scored:
        blocks += [_reminder(scored), _score_curves(scored), _score_table(m.metrics, scored)]
    else:
        blocks.append(Text("The dataset has no images to compare with, so there are no scores."))
    if m.model.motion is not None and m.view.truth is not None and len(m.view.ours) > 1:
        blocks.append(_differences(m))
    blocks += _displacement(m)
    if m.metrics["absent"]:
        lines = "; ".join(f"{what}: {why}" for what, why in m.metrics["absent"].items())
        blocks.append(Text(f"Not measured. {lines}."))
    blocks += [Text(note) for note in m.metrics["notes"]]
    return [Section("How true it is", blocks)]


def _reminder(scored: list[dict[str, Any]]) -> Block:
    last = scored[-1]
    still, alpha = last["rows"].get("nothing moves", {}).get("ssim"), last["alpha"]
    ceiling = last["rows"].get("ceiling", {}).get("ssim")
    if still is None:
        return Text("The images are too small for SSIM's window of 11 × 11 pixels.", "note")
    first = f"A model in which nothing moves scores SSIM {still:.4f} at α = {alpha:g}"
    if ceiling is None:
        return Text(f"{first}. Compare every score with that one.", "note")
    return Text(
        f"{first}, and the same model with the exact motion {ceiling:.4f}. Compare every score with "
        "these two; a model that also shows changes of light can exceed the second.",
        "note",
    )


def _score_curves(scored: list[dict[str, Any]]) -> Block:
    def draw(axes: Any) -> None:
        for name, _, colour in _METHODS:
            values = np.array([entry["rows"].get(name, {}).get("ssim") for entry in scored], float)
            if np.isfinite(values).any():
                axes.plot(values, "o-", color=colour, label=name)
        axes.set_xticks(range(len(scored)), [f"{entry['alpha']:g}" for entry in scored])
        axes.set(xlabel="magnification factor α", ylabel="SSIM")
        axes.legend(ncols=len(_METHODS))

    curves = chart(draw, "SSIM over magnification factor α")
    caption = (
        "SSIM of magnified test views against ground truth (1 is identical; 11 × 11 Gaussian window, σ = 1.5; mean "
        "over all test cameras and timesteps). “Ceiling” applies the exact motion to the same Gaussians: it "
        "lacks only what the static model and changes of light cost."
    )
    return Figure([drawing(curves)], caption, width="narrow")


def _score_table(metrics: dict[str, Any], scored: list[dict[str, Any]]) -> Block:
    columns = [c for c in _SCORES if c[0] in metrics["metrics"]]
    rows, styles = [], []
    for entry in scored:
        present = [(name, style) for name, style, _ in _METHODS if name in entry["rows"]]
        for i, (name, style) in enumerate(present):
            values = [(entry["rows"][name].get(key), form) for key, _, form in columns]
            cells = ["–" if v is None else f"{v:{form}}" for v, form in values]
            rows.append([f"{entry['alpha']:g}" if i == 0 else "", name, *cells])
            styles.append(style + (" last" if i == len(present) - 1 else ""))
    caption = f"Scores against ground truth, mean over {_counts(scored)} images each. "
    caption += "↑ higher is better, ↓ lower is better."
    why = metrics["absent"].get("LPIPS")
    caption += f" LPIPS was not measured: {why}." if why else ""
    return Table(["α", "method", *(title for _, title, _ in columns)], rows, caption, styles, left=2)


def _counts(scored: list[dict[str, Any]]) -> str:
    """Return the number of images for each α, as one number if it is the same for all."""
    counts = {entry["alpha"]: entry["n_images"] for entry in scored}
    if len({*counts.values()}) == 1:
        return str(scored[0]["n_images"])
    return ", ".join(f"{count} (α = {alpha:g})" for alpha, count in counts.items())


def _differences(m: Material) -> Block:
    assert m.view.truth is not None
    count = min(6, len(m.view.ours) - 1)
    found = {
        name: difference_maps(video / np.float32(255), count)
        for name, video in (("Ours", m.view.ours), ("Truth", m.view.truth))
    }
    top = max(largest for _, largest in found.values())
    panels = [
        picture(
            map_picture(one, top), f"{name}, {t} → {t + 1}", f"difference map: {name}, {t} to {t + 1}", True
        )
        for name, (maps, _) in found.items()
        for t, one in enumerate(maps)
    ]
    caption = (
        f"Difference maps |I(t + 1) − I(t)| of consecutive frames at α = {m.view.alpha:g} (TG4MM, Eq. 17; mean of the "
        "colour channels), all on one scale. Bright is where the picture changes. The rows should agree; where only "
        "the first is bright, its motion is false."
    )
    legend = colour_bar(top, "of full scale", "change of intensity")
    return Figure(panels, caption, columns=count, legend=legend)


def _displacement(m: Material) -> list[Block]:
    figures = m.metrics.get("displacement")
    if not figures:
        return [Text("The displacement error is not known: it needs the exact motion (truth/motion.npz).")]
    unit, factor = unit_of(m.train)
    header = ["frequency", f"true ({unit})", f"ours ({unit})", "ours / true", "error"]
    header += ["direction off by", "phase off by"]
    rows = [_frequency_row(row, factor) for row in figures["per_frequency"]]
    caption = (
        "Displacement against the exact motion, per true frequency: rms amplitude over Gaussians, weighted by their "
        "visibility in the training views."
    )
    return [Text(_displacement_words(figures, m.train.unit_scale_m)), Table(header, rows, caption)]


def _displacement_words(figures: dict[str, Any], unit_scale_m: float | None) -> str:
    error, leak = figures["relative_error"], figures["static_leak"]
    words = []
    if error is not None:
        words.append(
            f"The displacement error is {100 * error:.1f} % of the true motion (rms over timesteps, Gaussians)."
        )
    wrong, true = (both_lengths(figures[key], unit_scale_m) for key in ("rms_error", "rms_true"))
    words.append(f"The rms error is {wrong}, the rms of the true motion {true}.")
    if leak is not None:
        words.append(
            f"Static parts, {100 * figures['static_share']:.0f} % of the visible scene, were given motion of "
            f"{100 * leak:.1f} % of the rms of moving parts (static leak)."
        )
    if sure := figures.get("uncertainty"):
        words.append(
            f"The run estimates its error as {both_lengths(sure['said'], unit_scale_m)} rms; "
            f"{100 * sure['within_two']:.0f} % of the visible scene lie within two of its deviations."
        )
    return " ".join(words)


def _frequency_row(row: dict[str, Any], factor: float) -> list[str]:
    ratio, error = row["amplitude_ratio"], row["relative_error"]
    return [
        f"{number(row['frequency_hz'])} Hz",
        number(row["amplitude_true"] * factor, trim=False),
        number(row["amplitude_estimated"] * factor, trim=False),
        "–" if ratio is None else f"{ratio:.3f}",
        "–" if error is None else f"{100 * error:.1f} %",
        _degrees(row["direction_error_deg"]),
        _degrees(row["phase_error_deg"]),
    ]


def _degrees(value: float | None) -> str:
    return "–" if value is None else f"{round(value, 1) + 0.0:.1f}°".replace("-", "−")  # + 0.0: no −0.0


def cost_section(m: Material, files: Mapping[str, Path]) -> Section:
    """Return time and memory of each stage, and sizes on disk."""
    modes = ""
    if m.model.motion is not None:
        n = len(m.model.motion.freqs_hz)
        modes = f", each with {n} complex mode{'s' if n != 1 else ''} of displacement and rotation"
    blocks: list[Table | Text] = [Text(f"The model has {len(m.model.gaussians):,} Gaussians{modes}.")]
    if rows := [_stage(name, figures) for name, figures in m.run.log().items()]:
        header = ["stage", "time", "peak memory", "figures"]
        blocks.append(Table(header, rows, "Cost of each stage, from the run's log.", left=9))
    else:
        blocks.append(Text("The run's log holds no times."))
    there = {label: path for label, path in files.items() if path.exists()}
    sizes = [[label, size_text(size_on_disk(path)), str(path)] for label, path in there.items()]
    blocks.append(Table(["what", "size", "where"], sizes, "Sizes on disk.", left=9))
    return Section("What it cost", blocks)


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
    """Return the bytes of a file, or of a folder's files; one with several names (hard links) counts once."""
    if path.is_file():
        return path.stat().st_size
    stats = [p.stat() for p in path.rglob("*") if p.is_file()]
    return sum({(s.st_dev, s.st_ino): s.st_size for s in stats}.values())


def program() -> str:
    """Return how a shell calls this program: by name if it is on PATH, else by the path beside this Python."""
    if shutil.which("tg4mm"):
        return "tg4mm"
    beside = shutil.which("tg4mm", path=str(Path(sys.executable).parent))
    return shlex.quote(beside) if beside else f"{shlex.quote(sys.executable)} -m tg4mm"


def commands_section(m: Material, sensors: Sequence[Sensor], asked_alpha: float | None) -> Section:
    """Return commands that repeat this report, and next steps, with this run's paths and numbers."""
    run, alpha = str(m.run.path), f"{m.view.alpha:g}"
    band = [] if m.band is None else ["--band", *(f"{f:g}" for f in m.band)]
    named = [part for s in sensors for part in ("--sensor", str(s))]
    lines = [("Train again with the same settings", [*_train(m), "--out", f"{run}_again"])]
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
    following = f"{program()} {m.result.next_command.removeprefix('tg4mm ')}"
    texts = [("Next step, as the run suggests", following)]
    texts += [(what, f"{program()} {shlex.join(words)}") for what, words in lines]
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
    test = [*words, "--out", f"{run}_x{alpha}_test"]
    return [("Pictures and videos of this magnification", test), *lines] if m.view.split == "test" else lines


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
    """Return the settings of the run and of this page."""
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
    table = Table(["setting", "value"], rows, "Settings of the run and of this page.", left=9)
    return Section("Settings", [table])


def _flat(settings: Mapping[str, Any]) -> list[tuple[str, Any]]:
    out = []
    for stage, values in settings.items():
        is_many = isinstance(values, Mapping)
        out += [(f"{stage}.{k}", v) for k, v in values.items()] if is_many else [(stage, values)]
    return out


def _setting(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "–"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)
