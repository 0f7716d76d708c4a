"""Sections of the report on what is in the set: pictures, modes, motion in pixels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from PIL import Image

from tg4mm.core.pages import svg
from tg4mm.core.pages.charts import OURS, STILL, chart
from tg4mm.core.pages.page import Block, Figure, Section, Table, Text, drawing, picture
from tg4mm.core.pages.svg import number

from ..vibration import reach
from .dataset import Dataset, MotionTruth, View, hertz, length, percent, plural, read_picture, unit_of
from .modes import ModeSummary, Track, parts_text, phasor_maps, spectrum, together
from .noise_floor import FloorRow
from .pixels import Seen, ViewMotion, dotted, enlarged, overlay, ringed


@dataclass(frozen=True)
class Findings:
    """All that was read and measured for a report."""

    dataset: Dataset
    seen: Mapping[str, Seen]  # per-pixel truth of the test cameras that have it, by name
    views: tuple[ViewMotion, ...]  # test cameras first
    modes: tuple[ModeSummary, ...]  # () without truth/motion.npz
    still_area: float | None
    track: Track | None
    floor: tuple[FloorRow, ...]  # () without test views


def pictures_section(f: Findings, sheet: Image.Image) -> Section:
    """Contact sheet and what was recorded."""
    d = f.dataset
    counts = {split: len(d.by_camera(split)) for split in ("train", "test")}
    first = (d.views["train"] or d.views["test"])[0]
    alphas = ", ".join(f"{a:g}" for a in d.alphas)
    words = (
        f"{plural(counts['train'], 'training camera')} and {plural(counts['test'], 'test camera')}, "
        f"{plural(d.n_timesteps, 'timestep')} at {number(d.fps)} Hz ({number(d.n_timesteps / d.fps)} s), "
        f"{first.size[0]} × {first.size[1]} pixels. "
    )
    words += f"Ground truth at α = {alphas}. " if alphas else "Ground truth of magnified motion is absent. "
    words += (
        "Scale unknown: lengths are in scene units."
        if d.unit_scale_m is None
        else f"1 scene unit is {number(d.unit_scale_m)} m."
    )
    caption = (
        "Contact sheet (report/contact_sheet.png). Test cameras as captured, at timesteps 0 and farthest from "
        "rest, then magnified at each α at the timestep farthest from rest; training cameras below. A displacement "
        "grows to (1 + α) times its size."
    )
    return Section(
        "The pictures", [Text(words), Figure([picture(np.asarray(sheet), alt="contact sheet")], caption)]
    )


def motion_section(f: Findings) -> Section:
    """Modes: table, maps, one point over time."""
    if f.dataset.motion is None:
        absent = "truth/motion.npz is absent, so nothing is known of the modes but what scene.json says."
        return Section("How it moves", [Text(absent)])
    blocks: list[Block] = [
        _mode_table(f),
        *mode_maps(f.dataset, f.seen, f.track, [mode_name(f, k) for k in range(len(f.modes))]),
    ]
    if f.track is not None:
        blocks += _point(f, f.track)
    return Section("How it moves", blocks)


def _described(f: Findings, k: int) -> dict[str, Any]:
    modes = f.dataset.scene.get("modes") or []
    return modes[k] if k < len(modes) and isinstance(modes[k], dict) else {}


def mode_name(f: Findings, k: int) -> str:
    """What the description calls mode k, its kind, or its number."""
    described = _described(f, k)
    return str(described.get("name") or described.get("kind") or f"mode {k + 1}")


def _mode_table(f: Findings) -> Table:
    assert f.dataset.motion is not None
    rows = []
    for k, mode in enumerate(f.modes):
        cycles = mode.frequency_hz * f.dataset.n_timesteps / f.dataset.fps
        off = abs(cycles - round(cycles)) > 1e-6
        frequency = f"{number(mode.frequency_hz, 4)} Hz{', between bins' if off else ''}"
        rows.append(
            [
                mode_name(f, k),
                str(_described(f, k).get("kind", "–")),
                frequency if mode.frequency_hz else "drift",
                length(mode.amplitude, f.dataset.unit_scale_m),
                "yes" if f.dataset.motion.magnified[k] else "no",
                percent(mode.moving_area),
                parts_text(mode) or "nothing",
            ]
        )
    caption = (
        "The modes, from truth/motion.npz: largest displacement of any vertex, whether α magnifies the mode, share "
        "of the surface area that it moves, and the parts with their share of that displacement."
    )
    header = ["mode", "kind", "frequency", "amplitude", "magnified", "of the surface", "moving parts"]
    return Table(header, rows, caption, left=9)


def _point(f: Findings, track: Track) -> list[Block]:
    d = f.dataset
    unit, factor = unit_of(d)
    series = track.along * factor
    frequencies, amplitudes = spectrum(series, d.fps)
    where = ", ".join(f"{v:.2f}".replace("-", "−") for v in track.direction)
    strong = amplitudes > 0.05 * amplitudes.max(initial=0.0)
    panels = [
        drawing(time_chart(np.arange(d.n_timesteps) / d.fps, series, unit), "over time"),
        drawing(spectrum_chart(frequencies, amplitudes, unit, strong), "spectrum"),
    ]
    caption = Markup(
        "The point that moves most ({where}), along ({direction}), exact, at every timestep; and its discrete "
        "Fourier transform without a window. A frequency between bins spreads over its neighbours."
    ).format(where=track.where, direction=where)
    return [Figure(panels, caption)]


def pixels_section(f: Findings) -> Section:
    """Motion in pixels per view, and how much stands still."""
    if not f.views:
        return Section("Motion in pixels", [Text("Neither per-pixel truth nor truth/motion.npz is there.")])
    rows, styles = [], []
    for i, v in enumerate(f.views):
        last = i + 1 < len(f.views) and f.views[i + 1].split != v.split
        styles.append("last" if last else "")
        source = "per-pixel truth" if v.source == "truth" else "vertices"
        numbers = [number(x, 3, trim=False) for x in (v.maximum, v.p95, v.median)]
        rows.append([f"{v.split} {v.name}", *numbers, percent(v.still), f"{v.n:,}", source])
    caption = (
        "Motion in the picture at α = 0, pixels: the largest over time for every pixel (or vertex) that is displaced "
        "by more than 1 % of the set’s largest displacement; of these the maximum, 95th percentile and median. "
        "“Still” is the share of the surface pixels that never move. “Vertices”: projected vertices of "
        "truth/motion.npz inside the picture, hidden ones too and not weighted by area, for views without "
        "per-pixel truth."
    )
    header = ["view", "max", "95 %", "median", "still", "moving", "from"]
    words = ""
    if f.still_area is not None:
        words = f"Of the surface area of the scene, {percent(f.still_area)} is moved by no mode. "
    words += "Multiply by (1 + α) for the motion in the magnified ground truth"
    truth = f.dataset.motion
    words += "." if truth is None or bool(truth.magnified.all()) else ", of the modes that α magnifies."
    return Section("Motion in pixels", [Text(words), Table(header, rows, caption, styles=styles)])


_BAR = 0.6  # width, by the distance of two frequencies


def time_chart(times_s: np.ndarray, values: np.ndarray, unit: str) -> Markup:
    """A displacement [T] at times [T] with a dot at every sample; the scale reaches as far below zero as above."""
    span = float(np.abs(values).max(initial=0.0)) * 1.1 or 1.0

    def draw(axes: Any) -> None:
        axes.plot(times_s, values, "o-", color=OURS, linewidth=1.6, markersize=3.5)
        axes.set(xlabel="time (s)", ylabel=f"displacement ({unit})", ylim=(-span, span))

    return chart(draw, f"displacement ({unit}) over time (s)")


def spectrum_chart(freqs_hz: np.ndarray, amplitudes: np.ndarray, unit: str, strong: np.ndarray) -> Markup:
    """Amplitudes [F] at evenly spaced frequencies [F] as bars, those that are `strong` [F] in the colour of results."""
    width = _BAR * float(freqs_hz[1] - freqs_hz[0]) if len(freqs_hz) > 1 else _BAR

    def draw(axes: Any) -> None:
        axes.set_axisbelow(True)
        axes.bar(freqs_hz, amplitudes, width, color=np.where(strong, OURS, STILL))
        axes.set(xlabel="frequency (Hz)", ylabel=f"amplitude ({unit})")

    return chart(draw, f"amplitude ({unit}) over frequency (Hz)")


_MOST = 6


def mode_maps(
    dataset: Dataset, seen: Mapping[str, Seen], track: Track | None, names: Sequence[str]
) -> list[Block]:
    """A figure for each mode, those that go alike in time together; `names` are what the modes are called.

    From the per-pixel truth `seen` where it tells the modes apart, else from the vertices.
    """
    assert dataset.motion is not None
    motion, groups = together(dataset.motion)
    found = {name: phasor_maps(one, motion) for name, one in seen.items()}
    maps = {name: phasors for name, phasors in found.items() if phasors is not None}
    blocks: list[Block] = []
    for k, group in enumerate(groups[:_MOST]):
        frequency = float(motion.frequencies_hz[k])
        what = f"{_listed([names[i] for i in group])}, {hertz([frequency]) if frequency else 'a drift'}"
        gain = float(np.abs(motion.gains[:, k]).max(initial=0.0))
        if maps:
            amounts = {name: gain * reach(phasors[k]) for name, phasors in maps.items()}
            blocks.append(_truth_map(dataset, seen, track, amounts, what))
        else:
            blocks.append(_vertex_map(dataset, motion, k, gain, what))
    if seen and not maps:
        said = "The per-pixel truth does not tell the modes apart (the camera moves, or there are too few timesteps)."
        blocks.append(Text(said))
    if len(groups) > _MOST:
        blocks.append(Text(f"{len(groups) - _MOST} further modes have no map here."))
    return blocks


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} together"


def _truth_map(
    dataset: Dataset,
    seen: Mapping[str, Seen],
    track: Track | None,
    amounts: Mapping[str, np.ndarray],
    what: str,
) -> Figure:
    top = max((float(np.nanmax(a)) for a in amounts.values() if not np.isnan(a).all()), default=0.0)
    panels = []
    for name, amount in amounts.items():
        image = read_picture(seen[name].view.image)
        shown = enlarged(overlay(image, amount, top))
        if track is not None and track.view == name:
            shown = ringed(shown, track.pixel, shown.shape[0] // image.shape[0])
        panels.append(picture(shown, f"test {name}", crisp=True))
    unit, factor = unit_of(dataset)
    caption = (
        f"{what}: peak displacement, in 3D, of the surface that each pixel's centre sees, from the per-pixel truth "
        "over the picture in grey. Grey surfaces stand still, and grey pixels at an edge see one surface after "
        "another. The ring marks the point that is shown over time."
    )
    return Figure(panels, caption, legend=svg.colour_bar(top * factor, unit, "peak displacement"))


def _vertex_map(dataset: Dataset, motion: MotionTruth, k: int, gain: float, what: str) -> Figure | Text:
    view = _any_view(dataset)
    if view is None:
        return Text("There is no picture to draw the motion into.")
    points = np.concatenate([body.rest for body in motion.bodies]).astype(np.float64)
    amounts = gain * np.concatenate([reach(body.modes[k]) for body in motion.bodies])
    top = float(amounts.max(initial=0.0))
    unit, factor = unit_of(dataset)
    panel = picture(
        enlarged(dotted(read_picture(view.image), view, points, amounts, top)), view.name, crisp=True
    )
    caption = (
        f"{what}: peak displacement, in 3D, of the vertices in this view, hidden ones too, from truth/motion.npz, "
        "since there is no per-pixel truth that could be used."
    )
    legend = svg.colour_bar(top * factor, unit, "peak displacement")
    return Figure([panel], caption, legend=legend, width="small")


def _any_view(dataset: Dataset) -> View | None:
    views = dataset.views["test"] or dataset.views["train"]
    return next((view for view in views if view.image.is_file()), None)
