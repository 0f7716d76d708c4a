"""The section on how true the result is: scores beside their two anchors, difference maps, displacement."""

from typing import Any

import numpy as np

from tg4mm.core.pages import svg
from tg4mm.core.pages.charts import CEILING, OURS, STILL, chart
from tg4mm.core.pages.page import Block, Figure, Section, Table, Text, drawing, picture
from tg4mm.core.pages.svg import number
from tg4mm.show.report.figures import map_picture
from tg4mm.show.report.summary import Material, both_lengths
from tg4mm.show.result.model import unit_of
from tg4mm.show.slices import difference_maps

_METHODS = (("nothing moves", "still"), ("ours", "ours"), ("ceiling", "ceiling"))  # name, CSS class
_COLOURS = {"still": STILL, "ours": OURS, "ceiling": CEILING}
_SCORES = (
    ("psnr_db", "PSNR (dB) ↑", ".2f"),
    ("ssim", "SSIM ↑", ".4f"),
    ("flip", "FLIP ↓", ".4f"),
    ("lpips", "LPIPS ↓", ".4f"),
)


def accuracy_section(m: Material) -> list[Section]:
    """Scores beside their two anchors, difference maps, displacement error; [] without ground truth."""
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
    words = f"A model in which nothing moves scores SSIM {still:.4f} at α = {alpha:g}"
    if ceiling is None:
        return Text(f"{words}. A score says something about motion only beside that one.", "note")
    words += f", and the same model moved exactly right {ceiling:.4f}"
    return Text(
        f"{words}. A score says something about motion only beside those two; above the second lies what "
        "shows changes of light that it lacks.",
        "note",
    )


def _score_curves(scored: list[dict[str, Any]]) -> Block:
    def draw(axes: Any) -> None:
        for name, style in _METHODS:
            values = [entry["rows"].get(name, {}).get("ssim") for entry in scored]
            if any(value is not None for value in values):
                axes.plot(
                    places,
                    [np.nan if v is None else v for v in values],
                    "o-",
                    color=_COLOURS[style],
                    label=name,
                )
        axes.set_xticks(places, [f"{entry['alpha']:g}" for entry in scored])
        axes.set(xlabel="magnification factor α", ylabel="SSIM")
        axes.legend(ncols=len(_METHODS))

    places = range(len(scored))
    curves = chart(draw, "SSIM over magnification factor α")
    caption = (
        "SSIM of magnified test views against ground truth (1 is identical; 11 × 11 Gaussian window, σ = "
        "1.5; "
        "mean over all test cameras and timesteps). “Ceiling” applies the exact motion to the same "
        "Gaussians: "
        "what is lost there is the static model's, and the changes of light that it does not show."
    )
    return Figure([drawing(curves)], caption, width="narrow")


def _score_table(metrics: dict[str, Any], scored: list[dict[str, Any]]) -> Block:
    columns = [c for c in _SCORES if c[0] in metrics["metrics"]]
    rows, styles = [], []
    for entry in scored:
        present = [(name, style) for name, style in _METHODS if name in entry["rows"]]
        for i, (name, style) in enumerate(present):
            values = [entry["rows"][name].get(key) for key, _, _ in columns]
            cells = [
                "–" if v is None else f"{v:{form}}" for v, (_, _, form) in zip(values, columns, strict=True)
            ]
            rows.append([f"{entry['alpha']:g}" if i == 0 else "", name, *cells])
            styles.append(style + (" last" if i == len(present) - 1 else ""))
    caption = f"Scores against ground truth, mean over {_counts(scored)} images each. "
    caption += "↑ higher is better, ↓ lower is better."
    why = metrics["absent"].get("LPIPS")
    caption += f" LPIPS was not measured: {why}." if why else ""
    return Table(["α", "method", *(title for _, title, _ in columns)], rows, caption, styles, left=2)


def _counts(scored: list[dict[str, Any]]) -> str:
    """How many images each α is scored by, one number where it is the same for all."""
    counts = {entry["alpha"]: entry["n_images"] for entry in scored}
    if len({*counts.values()}) == 1:
        return str(scored[0]["n_images"])
    return ", ".join(f"{count} (α = {alpha:g})" for alpha, count in counts.items())


def _differences(m: Material) -> Block:
    count = min(6, len(m.view.ours) - 1)
    ours, top = difference_maps(m.view.ours / np.float32(255), count)
    assert m.view.truth is not None
    truth, true_top = difference_maps(m.view.truth / np.float32(255), count)
    top = max(top, true_top)
    named = [("Ours", ours), ("Truth", truth)]
    panels = [
        picture(
            map_picture(one, top),
            f"{name}, {t} → {t + 1}",
            f"difference map: {name}, {t} to {t + 1}",
            photo=True,
        )
        for name, maps in named
        for t, one in enumerate(maps)
    ]
    caption = (
        f"Difference maps |I(t + 1) − I(t)| of consecutive frames at α = {m.view.alpha:g} (TG4MM, Eq. 17; "
        "mean of "
        "the colour channels), all on one scale. Bright is where the picture changes. "
    )
    caption += (
        "The rows should agree; light in the first that is not in the second is motion that is not there."
    )
    legend = svg.colour_bar(top, "of full scale", "change of intensity")
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
        "Displacement against the exact motion, per true frequency: rms amplitude over Gaussians, "
        "weighted by "
        "what the training views see."
    )
    return [Text(_displacement_words(figures, m.train.unit_scale_m)), Table(header, rows, caption)]


def _displacement_words(figures: dict[str, Any], unit_scale_m: float | None) -> str:
    error, leak = figures["relative_error"], figures["static_leak"]
    words = []
    if error is not None:
        words.append(
            f"The displacement error is {100 * error:.1f} % of the true motion (rms over timesteps and "
            "Gaussians)."
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
