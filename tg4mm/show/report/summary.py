"""The head of a report, the table of vibrations, and the limits, from the run's `Result`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from tg4mm.capture import Capture
from tg4mm.core.choices import Clock
from tg4mm.core.digits import number
from tg4mm.core.pages.page import Block, Section, Stat, Table, Text
from tg4mm.core.phasors import main_direction
from tg4mm.run import Run
from tg4mm.show.measure import Measurement
from tg4mm.show.report.sources import CameraVideos, Model
from tg4mm.show.result.model import Length, Result, Vibration, amount, percent, with_deviation


@dataclass(frozen=True)
class Material:
    """The input of all sections."""

    run: Run
    train: Capture
    model: Model
    view: CameraVideos
    result: Result
    metrics: dict[str, Any]  # of evaluate_run, {} if there is no ground truth
    measurement: Measurement | None  # of sensors; None if there is nothing to measure
    why_no_sensors: str  # "" if there are some, or no motion
    why_alpha: str = ""  # how α was chosen; "" if it was given
    warning: str = ""  # if α exceeds the limits of the motion
    orbit: Path | None = None  # a folder of render_orbit: the scene from a moving camera

    @property
    def why_still(self) -> str:
        """The reason why a model has no motion."""
        if self.train.n_timesteps == 1:
            return "A capture of one timestep has no motion to magnify."
        return "No vibration stands out of the noise, so there is nothing to magnify."

    @property
    def band(self) -> tuple[float, float] | None:
        """The magnified band, Hz; None: all frequencies."""
        return next(iter(self.view.magnified.limits), None)

    @property
    def main(self) -> Vibration | None:
        """The strongest magnified vibration."""
        inside = (v for v in self.result.vibrations if self.view.magnified.inside(np.array(v.hz)))
        return next(inside, None)


def size_of(v: Vibration, result: Result) -> tuple[str, str]:
    """Return (value ± deviation, unit) of a vibration's amplitude: pixels for a flat capture, else as `amount`."""
    if result.is_flat and v.pixels is not None:
        return with_deviation(v.pixels), "px"
    return amount(v.amplitude, result.unit_scale_m)


def length(value: float, unit_scale_m: float | None, digits: int = 3) -> tuple[str, str]:
    """Return (value, unit) of a length in scene units: millimetres or finer if the scale is known, else units."""
    if unit_scale_m is None:
        return number(value, digits), "units"
    millimetres = value * unit_scale_m * 1000.0
    if 0 < millimetres < 0.1:
        return number(millimetres * 1000.0, digits), "µm"
    return number(millimetres, digits), "mm"


def both_lengths(value: float, unit_scale_m: float | None) -> str:
    """Return a length in scene units and, if the scale is known, in millimetres."""
    text = f"{number(value)} scene units"
    return text if unit_scale_m is None else f"{text} ({' '.join(length(value, unit_scale_m))})"


def clock(seconds: float) -> str:
    """Return a duration as 48 s, 3 min 20 s or 1 h 05 min."""
    total = round(seconds)
    if total < 60:
        return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"
    if total < 3600:
        return f"{total // 60} min {total % 60:02d} s"
    return f"{total // 3600} h {total % 3600 // 60:02d} min"


def total_seconds(log: Mapping[str, Any]) -> float | None:
    """Return the seconds of all stages of a run's log, None if it has none."""
    found = [v.get("seconds") for v in log.values() if isinstance(v, dict)]
    known = [s for s in found if isinstance(s, int | float)]
    return float(sum(known)) if known else None


def row_of(metrics: dict[str, Any], alpha: float) -> dict[str, Any] | None:
    """Return the entry of metrics["alphas"] at `alpha`."""
    return next((entry for entry in metrics.get("alphas", []) if entry["alpha"] == alpha), None)


def summary(m: Material) -> str:
    """Return the main result in one sentence."""
    views = m.result.n_cameras
    what = "pose" if m.view.clock == Clock.moving else "camera"
    seen = f"{views} {what}{'s' if views != 1 else ''}, {m.train.n_timesteps} timestep"
    seen += "s" if m.train.n_timesteps != 1 else ""
    if m.model.motion is None:
        return f"A static model from {seen}. {m.why_still}"
    shown = f"shown here {1 + m.view.alpha:g} times larger"
    if m.main is None:
        where = "" if m.band is None else f" from {m.band[0]:g} to {m.band[1]:g} Hz"
        return f"No vibration was found{where} in {seen} at {number(m.train.fps)} Hz; the motion is {shown}."
    value, unit = size_of(m.main, m.result)
    hz = with_deviation(Length(m.main.hz, m.main.deviation_hz))
    others = [v for v in m.result.vibrations if v is not m.main]
    more = f" It also vibrates at {' and '.join(number(v.hz) for v in others[:3])} Hz." if others else ""
    how = "in 3D from" if views > 1 else "across the line of sight of"
    return (
        f"The strongest vibration is {value} {unit} at {hz} Hz, measured {how} {seen} at "
        f"{number(m.train.fps)} Hz, and {shown}.{more}"
    )


def stats(m: Material) -> list[Stat]:
    """Return the headline figures; those that need ground truth only if there is some."""
    found = _motion_stats(m)
    if m.metrics:
        found += [*_ssim_stat(m), *_error_stat(m)]
    seconds = total_seconds(m.run.log())
    if seconds is not None:
        found.append(Stat("Training time", clock(seconds), note="the stages in the run's log"))
    return found


def _motion_stats(m: Material) -> list[Stat]:
    if m.model.motion is None:
        return [Stat("Motion", "none", note=m.why_still)]
    found = _vibration_stats(m) if m.main is not None else [Stat("Vibration", "none", note="none was found")]
    if m.result.noise is not None:
        value, unit = length(m.result.noise, m.result.unit_scale_m, digits=2)
        pixels = "" if m.result.noise_px is None else f"{m.result.noise_px:.2g} px: "
        if m.result.is_flat and m.result.noise_px is not None:
            value, unit, pixels = f"{m.result.noise_px:.2g}", "px", ""
        found.append(Stat("Noise floor", value, unit, f"{pixels}at this amplitude, motion equals noise"))
    return found


def _vibration_stats(m: Material) -> list[Stat]:
    assert m.main is not None
    assert m.model.motion is not None
    value, unit = size_of(m.main, m.result)
    pixels = "" if m.main.pixels is None or m.result.is_flat else f"{with_deviation(m.main.pixels)} px; "
    k = int(np.argmin(np.abs(m.model.motion.freqs_hz - m.main.hz)))
    hz = with_deviation(Length(m.main.hz, m.main.deviation_hz))
    return [
        Stat("Frequency", hz, "Hz", f"a record of {number(m.result.duration_s)} s"),
        Stat("Amplitude", value, unit, f"{pixels}peak, 99th percentile of the visible"),
        _direction_stat(main_direction(m.model.motion.displacement_of(k), m.model.weights), m.result.is_flat),
    ]


def _direction_stat(direction: np.ndarray, is_flat: bool) -> Stat:
    if is_flat:  # whose picture lies in the plane of x and z
        return Stat("Direction", vector(direction[[0, 2]]), "", "right and up in the picture")
    axis = int(np.argmax(np.abs(direction)))
    angle, name = float(np.degrees(np.arccos(np.clip(abs(direction[axis]), 0, 1)))), "XYZ"[axis]
    if angle < 10:
        return Stat("Direction", f"± {name}", "", f"({vector(direction)}), {angle:.1f}° off the world's axis")
    return Stat("Direction", vector(direction), "", f"unit vector, {angle:.0f}° off the world's {name} axis")


def vector(direction: np.ndarray) -> str:
    """Return a vector to two decimals."""
    return ", ".join(f"{c:.2f}".replace("-0.00", "0.00").replace("-", "−") for c in direction)


def _ssim_stat(m: Material) -> list[Stat]:
    entry = row_of(m.metrics, m.view.alpha)
    ours = entry["rows"].get("ours", {}).get("ssim") if entry else None
    if entry is None or ours is None:
        return []
    others = {name: entry["rows"].get(name, {}).get("ssim") for name in ("ceiling", "nothing moves")}
    note = ", ".join(f"{name} {value:.4f}" for name, value in others.items() if value is not None)
    return [Stat(f"SSIM at α = {m.view.alpha:g}", f"{ours:.4f}", note=note)]


def _error_stat(m: Material) -> list[Stat]:
    figures = m.metrics.get("displacement")
    if not figures or figures.get("relative_error") is None:
        return []
    absolute = both_lengths(figures["rms_error"], m.train.unit_scale_m)
    return [Stat("Displacement error", f"{100 * figures['relative_error']:.1f}", "%", f"rms {absolute}")]


def vibrations_table(m: Material) -> list[Block]:
    """Return a table of all vibrations; [] without any."""
    if not m.result.vibrations:
        return []
    position = "largest at pixel" if m.result.is_flat else "largest at (x, y, z)"
    header = ["frequency (Hz)", "amplitude", "in pictures", "damping ratio", position, "band (Hz)"]
    caption = (
        "Vibrations that the run found, the strongest first: peak displacement where it is largest (1 % of the visible "
        "moves further), ± one standard deviation. The band, given as --band, magnifies that vibration alone."
    )
    return [Table(header, [_row(m, v) for v in m.result.vibrations], caption)]


def _row(m: Material, v: Vibration) -> list[str]:
    value, unit = size_of(v, m.result)
    pixels = "–" if v.pixels is None else f"{with_deviation(v.pixels)} px"
    damping = percent(v.damping, v.damping_deviation)
    position = ", ".join(f"{c:.3g}" for c in v.position)
    if v.position_px is not None:
        position = f"{v.position_px[0]:.0f}, {v.position_px[1]:.0f}"
    hz = with_deviation(Length(v.hz, v.deviation_hz))
    return [hz, f"{value} {unit}", pixels, damping, position, f"{v.band[0]:g} to {v.band[1]:g}"]


def limits_section(m: Material) -> Section:
    """Return the limits of the run and of the sensors."""
    measured = () if m.measurement is None else m.measurement.notes
    lines = list(dict.fromkeys(filter(None, [*m.result.cannot, *measured, m.why_no_sensors])))
    damping = sorted({v.why_no_damping for v in m.result.vibrations if v.why_no_damping})
    lines += [f"damping: {why}" for why in damping if not any(why in line for line in lines)]
    items = Markup("").join(Markup("<li>{}</li>").format(line[:1].upper() + line[1:]) for line in lines)
    listed = Text(Markup('<ul class="points">{}</ul>').format(items), plain=True)
    return Section(
        "What could not be determined", [listed if lines else Text("Nothing that this run knows of.")]
    )
