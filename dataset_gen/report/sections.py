"""Sections of the report on what is in the set: pictures, modes, motion in pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from PIL import Image

from tg4mm.core.pages.page import Block, Figure, Section, Table, Text, drawing, picture
from tg4mm.core.pages.svg import number

from .chart import spectrum_chart, time_chart
from .dataset import Dataset
from .maps import mode_maps
from .modes import ModeSummary, Track, parts_text, spectrum
from .noise_floor import FloorRow
from .pixels import Seen, ViewMotion
from .text import length, percent, plural, unit_of


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
