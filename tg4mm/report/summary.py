"""The head of a report: title, headline figures, and the videos side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from tg4mm.capture import Capture
from tg4mm.report.figures import scale_top
from tg4mm.report.maps import main_direction, peak_displacement
from tg4mm.report.page import Block, Figure, Panel, Stat, film, missing, picture
from tg4mm.report.sources import Model, View
from tg4mm.report.svg import number
from tg4mm.report.video import clip
from tg4mm.runs import Run


@dataclass(frozen=True)
class Material:
    """Everything the sections draw on."""

    run: Run
    train: Capture
    model: Model
    view: View
    metrics: dict[str, Any]  # as evaluate_run returns it, {} if nothing was evaluated
    band: tuple[float, float] | None
    seconds: float | None  # of training, None if unknown
    orbit: Path | None = None  # a folder of render_orbit: the scene from a moving camera


def length(value: float, unit_scale_m: float | None, digits: int = 3) -> tuple[str, str]:
    """(value, unit) of a length in scene units: millimetres or finer where the scale is known, else units."""
    if unit_scale_m is None:
        return number(value, digits), "units"
    millimetres = value * unit_scale_m * 1000.0
    if 0 < millimetres < 0.1:
        return number(millimetres * 1000.0, digits), "µm"
    return number(millimetres, digits), "mm"


def unit_of(unit_scale_m: float | None) -> tuple[str, float]:
    """(unit, factor) that lengths in scene units are shown in: mm where the scale is known."""
    return ("scene units", 1.0) if unit_scale_m is None else ("mm", unit_scale_m * 1000.0)


def both_lengths(value: float, unit_scale_m: float | None) -> str:
    """A length in scene units and, where the scale is known, in millimetres."""
    text = f"{number(value)} scene units"
    return text if unit_scale_m is None else f"{text} ({' '.join(length(value, unit_scale_m))})"


def clock(seconds: float) -> str:
    """A duration as 48 s, 3 min 20 s or 1 h 05 min."""
    total = round(seconds)
    if total < 60:
        return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"
    if total < 3600:
        return f"{total // 60} min {total % 60:02d} s"
    return f"{total // 3600} h {total % 3600 // 60:02d} min"


def main_motion(model: Model) -> tuple[float, float, np.ndarray]:
    """(frequency Hz, peak displacement in scene units, unit direction [3]) of the strongest in-band mode.

    The peak is the 99.5th percentile over what the cameras see, so that one stray Gaussian does not set it.
    """
    assert model.motion is not None
    phasors = model.motion.displacement[model.main]
    peak = scale_top(peak_displacement(phasors), model.weights)
    return float(model.motion.freqs_hz[model.main]), peak, main_direction(phasors, model.weights)


def title_of(train: Capture) -> str:
    """The scene's own name, else the dataset folder's."""
    return str(train.scene.get("scene") or train.root.resolve().name)


def row_of(metrics: dict[str, Any], alpha: float) -> dict[str, Any] | None:
    """The entry of metrics["alphas"] at `alpha`."""
    return next((entry for entry in metrics.get("alphas", []) if entry["alpha"] == alpha), None)


def summary(m: Material) -> str:
    """One sentence on what was found."""
    views = len(set(m.train.camera_ids.tolist()))
    seen = f"{views} camera{'s' if views != 1 else ''}, {m.train.n_timesteps} timestep"
    seen += "s" if m.train.n_timesteps != 1 else ""
    if m.model.motion is None:
        return f"A static model from {seen}. A capture of one timestep has no motion to magnify."
    frequency, peak, _ = main_motion(m.model)
    amount = " ".join(length(peak, m.train.unit_scale_m))
    return (
        f"The strongest motion found is {amount} at {number(frequency)} Hz, measured in 3D from {seen} at "
        f"{number(m.train.fps)} Hz, and shown here {1 + m.view.alpha:g} times larger."
    )


def stats(m: Material) -> list[Stat]:
    """The headline figures; those that need truth say what is missing."""
    found = [*_motion_stats(m), _ssim_stat(m), _error_stat(m)]
    if m.seconds is not None:
        found.append(Stat("Training time", clock(m.seconds), note="the stages in the run's log"))
    return found


def _motion_stats(m: Material) -> list[Stat]:
    if m.model.motion is None:
        return [Stat("Motion", "none", note="one timestep was captured")]
    frequency, peak, direction = main_motion(m.model)
    value, unit = length(peak, m.train.unit_scale_m)
    where = f"{number(peak)} scene units; " if m.train.unit_scale_m is not None else "scale unknown; "
    resolution = m.train.fps / m.train.n_timesteps
    return [
        Stat("Amplitude", value, unit, f"{where}peak, 99.5th percentile of what is seen"),
        Stat(
            "Frequency", number(frequency), "Hz", f"the recording resolves steps of {number(resolution)} Hz"
        ),
        _direction_stat(direction),
    ]


def _direction_stat(direction: np.ndarray) -> Stat:
    axis = int(np.argmax(np.abs(direction)))
    angle = float(np.degrees(np.arccos(np.clip(abs(direction[axis]), 0, 1))))
    if angle < 10:
        return Stat(
            "Direction", f"± {'XYZ'[axis]}", "", f"({vector(direction)}), {angle:.1f}° off the world's axis"
        )
    return Stat(
        "Direction", vector(direction), "", f"unit vector, {angle:.0f}° off the world's {'XYZ'[axis]} axis"
    )


def vector(direction: np.ndarray) -> str:
    """A vector to two decimals."""
    return ", ".join(f"{c:.2f}".replace("-0.00", "0.00").replace("-", "−") for c in direction)


def _ssim_stat(m: Material) -> Stat:
    entry = row_of(m.metrics, m.view.alpha)
    ours = entry["rows"].get("ours", {}).get("ssim") if entry else None
    if entry is None or ours is None:
        return Stat(f"SSIM at α = {m.view.alpha:g}", "–", note="no ground truth at this magnification")
    parts = [
        f"{name} {entry['rows'][name]['ssim']:.4f}"
        for name in ("ceiling", "nothing moves")
        if entry["rows"].get(name, {}).get("ssim") is not None
    ]
    return Stat(f"SSIM at α = {m.view.alpha:g}", f"{ours:.4f}", note=", ".join(parts))


def _error_stat(m: Material) -> Stat:
    figures = m.metrics.get("displacement")
    if not figures or figures.get("relative_error") is None:
        return Stat("Displacement error", "–", note="the dataset has no exact motion")
    absolute = both_lengths(figures["rms_error"], m.train.unit_scale_m)
    return Stat("Displacement error", f"{100 * figures['relative_error']:.1f}", "%", f"rms {absolute}")


def _stills(m: Material) -> list[Block]:
    panels = [missing(m.view.why_no_input, "Input")]
    if m.view.input is not None:
        panels = [picture(m.view.input[0], "Input, as captured")]
    panels.append(picture(m.view.ours[0], "The static model, rendered"))
    caption = Markup(
        "The {split} camera <code>{camera}</code> at timestep 0. There is no motion to play."
    ).format(split=m.view.split, camera=m.view.camera.name)
    return [Figure(panels, caption)]


def videos(m: Material) -> list[Block]:
    """Input, ours and truth side by side; one figure, in step."""
    fps = m.train.fps
    size = f"{m.train.width} × {m.train.height} pixels"
    if m.model.motion is None:
        return _stills(m)
    magnified = f"α = {m.view.alpha:g}"
    named = [
        ("Input, as captured", m.view.input, m.view.why_no_input),
        (f"Ours, {magnified}", m.view.ours, ""),
        (f"Ground truth, {magnified}", m.view.truth, m.view.why_no_truth),
    ]
    still = m.view.widest_time
    panels: list[Panel] = [
        missing(why, label)
        if video is None
        else film(clip(video, fps), video[still], label, f"video: {label}")
        for label, video, why in named
    ]
    caption = Markup(
        "The {split} camera <code>{camera}</code>, which sees most of the motion, in real time ({fps} Hz, "
        "{size}, repeated). Input is what the camera recorded; ours is the model rendered with every "
        "displacement "
        "δ as (1 + {alpha}) δ. Look for edges that stay sharp while they move, and for anything that "
        "moves in "
        "ours but not in the truth."
    ).format(
        split=m.view.split, camera=m.view.camera.name, fps=number(fps), size=size, alpha=f"{m.view.alpha:g}"
    )
    return [Figure(panels, caption, controls=True)]
