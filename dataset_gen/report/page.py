"""The report of a dataset: `report/index.html` and the contact sheet as a picture of its own."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tg4mm.core import __version__
from tg4mm.core.pages.page import Block, Figure, Page, Section, Stat, Table, Text, picture, render_page
from tg4mm.core.pages.svg import number, size_text
from tg4mm.core.records import read_formed

from ..tree import TIMING, whole
from .findings import Findings, Mode, find, magnified, read_picture

_EDGE = 168  # of a picture of the contact sheet, pixels
_GAP, _LABEL = 6, 20  # between them and under them, pixels
_ACROSS = 6  # training cameras in a row
_MOST_TEST, _MOST_TRAIN, _MOST_PARTS = 3, 18, 6
_SMALL_PX = 0.01  # motion below this is far under the noise of a single picture
_CLOSE_DB = 1.0  # a perfect method that is no better than this above a still picture cannot be told from it


def write(root: Path) -> Path:
    """See `dataset_gen.report.write_report`."""
    findings = find(root)
    folder = root / "report"
    folder.mkdir(exist_ok=True)
    sheet = contact_sheet(findings)
    page = render_page(_page(findings, sheet))
    _save(folder / "contact_sheet.png", lambda path: sheet.save(path, "PNG"))
    _save(folder / "index.html", lambda path: path.write_text(page, encoding="utf-8"))
    return folder / "index.html"


def _save(path: Path, make: Callable[[Path], object]) -> None:
    with whole(path) as temporary:
        make(temporary)


def _page(f: Findings, sheet: Image.Image) -> Page:
    scene = str(f.any.scene.get("scene", f.root.name))
    return Page(
        title=f"{scene[:1].upper()}{scene[1:]}: a set with exact motion",
        kicker="vibration dataset, report of its contents",
        summary=f"{_cameras(f)}, {f.any.width} × {f.any.height} pixels, {_length(f, f.amplitude)} of motion at most.",
        stats=_stats(f),
        lead=[Text(words, style="note") for words in warnings(f)],
        sections=[
            Section("The pictures", [_sheet_figure(sheet)]),
            Section("How it moves", list(_motion(f))),
            Section("What a perfect method would score", list(_floor(f))),
        ],
        footer=f"tg4mm {__version__}. {f.root.name}. Written from the files of the set alone.",
    )


def warnings(f: Findings) -> list[str]:
    """What a user of the set should know first: what is absent, and what makes it hard to use."""
    said = []
    if f.test is None:
        said.append("There are no test views, so there is nothing to score.")
    if not f.alphas:
        said.append("Ground truth of magnified motion is absent.")
    if not f.strength.size:
        said.append("truth/motion.npz is absent: the motion is known from scene.json only.")
    if f.any.unit_scale_m is None:
        said.append("Scale unknown: lengths are in scene units.")
    for mode in f.modes:
        if _between_bins(f, mode):
            said.append(
                f"The frequency of {mode.name}, {number(mode.frequency_hz, 4)} Hz, lies between the bins of the set's "
                f"{f.any.n_timesteps} timesteps: its spectrum spreads over the neighbours."
            )
    largest = max((view.maximum for view in f.views), default=None)
    if largest is not None and largest < _SMALL_PX:
        said.append(f"The motion is small: {number(largest)} pixels at most in any picture.")
    for row in f.scores:
        if (
            row.alpha
            and row.perfect is not None
            and row.still is not None
            and row.perfect - row.still < _CLOSE_DB
        ):
            said.append(
                f"At α = {row.alpha:g} a still picture scores {row.still:.2f} dB and a perfect method "
                f"{row.perfect:.2f} dB: the score hardly distinguishes them."
            )
    return said


def _stats(f: Findings) -> list[Stat]:
    capture = f.any
    seconds = number(capture.n_timesteps / capture.fps)
    value, unit = size_text(_bytes_on_disk(f.root)).split(" ")
    stats = [
        Stat("Timesteps", str(capture.n_timesteps), "", f"{number(capture.fps)} Hz, {seconds} s"),
        Stat("Largest displacement", number(f.amplitude), "units", "at any timestep, α = 0"),
        Stat("On disk", value, unit, "equal pictures counted once"),
    ]
    if f.views:
        view = max(f.views, key=lambda v: v.maximum)
        stats.insert(2, Stat("Largest motion in a picture", number(view.maximum), "px", f"in {view.name}"))
    try:
        timing = read_formed(f.root / "report/timing.json", TIMING)
        stats.append(
            Stat("Rendered in", number(timing["seconds"]), "s", f"{timing['pictures']:,} distinct pictures")
        )
    except (OSError, ValueError):
        pass  # a set that was copied without it, or made elsewhere
    return stats


def _bytes_on_disk(root: Path) -> int:
    files = (path.stat() for path in root.rglob("*") if path.is_file() and "report" not in path.parts)
    return sum({(stat.st_dev, stat.st_ino): stat.st_size for stat in files}.values())


def _sheet_figure(sheet: Image.Image) -> Figure:
    caption = (
        "Contact sheet (report/contact_sheet.png). Test cameras at timesteps 0 and farthest from rest, then magnified "
        "at each α; training cameras below. A displacement grows to (1 + α) times its size."
    )
    return Figure([picture(np.asarray(sheet), alt="contact sheet")], caption)


def _motion(f: Findings) -> Iterable[Block]:
    rows = [
        [
            mode.name,
            f"{number(mode.frequency_hz, 4)} Hz" if mode.frequency_hz else "drift",
            _length(f, mode.amplitude),
            "yes" if mode.magnified else "no",
            _parts(mode),
        ]
        for mode in f.modes
    ]
    if rows:
        caption = (
            "From truth/motion.npz: largest displacement of any vertex, and the parts with their share of it."
        )
        yield Table(["mode", "frequency", "amplitude", "magnified", "moving parts"], rows, caption, left=5)
    if f.views:
        caption = (
            "Motion in the picture at α = 0, pixels: of each vertex that moves the largest over time; hidden vertices "
            "inside the picture count, too. Multiply by (1 + α) for the magnified ground truth."
        )
        rows = [[v.name, *(number(x, 3, trim=False) for x in (v.maximum, v.p95, v.median))] for v in f.views]
        yield Table(["camera", "max", "95 %", "median"], rows, caption)


def _parts(mode: Mode) -> str:
    shown = [f"{name} ({100 * size / mode.amplitude:.0f} %)" for name, size in mode.parts[:_MOST_PARTS]]
    more = len(mode.parts) - len(shown)
    return (", ".join(shown) or "nothing") + (f" and {more} more" if more else "")


def _floor(f: Findings) -> Iterable[Block]:
    rows = [[f"{s.alpha:g}", *(_decibel(x) for x in (s.still, s.pair, s.perfect))] for s in f.scores]
    if rows:
        caption = (
            "PSNR over white against the truth, dB. “Perfect method”: exact and free of noise, 3.01 dB above another "
            "render of the truth, which differs by the noise of both. “Nothing moves”: the rest picture of the same "
            "camera, with noise of its own where report/reseeded/ has one. A dash: no second render."
        )
        yield Table(["α", "nothing moves", "another render", "perfect method"], rows, caption)


def _decibel(value: float | None) -> str:
    if value is None:
        return "–"
    return "equal" if value >= 100 else f"{value:.2f}"


def _between_bins(f: Findings, mode: Mode) -> bool:
    cycles = mode.frequency_hz * f.any.n_timesteps / f.any.fps
    return abs(cycles - round(cycles)) > 1e-6


def _cameras(f: Findings) -> str:
    counts = [
        (len({p.stem for p in c.paths}) if c else 0, split)
        for c, split in ((f.train, "training"), (f.test, "test"))
    ]
    return " and ".join(f"{n} {split} camera{'' if n == 1 else 's'}" for n, split in counts)


def _length(f: Findings, value: float) -> str:
    text, scale = f"{number(value)} units", f.any.unit_scale_m
    if scale is None:
        return text
    metres = value * scale
    unit, factor = next(((u, k) for u, k in (("m", 1.0), ("mm", 1e-3)) if abs(metres) >= k), ("µm", 1e-6))
    return f"{text} ({number(metres / factor)} {unit})"


def contact_sheet(f: Findings) -> Image.Image:
    """Test cameras as captured and magnified, a row each; then training cameras at timestep 0. On white."""
    rows: list[tuple[str, list[tuple[Path, str]]]] = []
    if f.test is not None:
        views = list(zip(f.test.paths, f.test.timesteps.tolist(), strict=True))
        for name in list(dict.fromkeys(path.stem for path, _ in views))[:_MOST_TEST]:
            own = {t: path for path, t in views if path.stem == name}
            cells = [(own[t], f"t = {t}") for t in sorted({0, f.strongest}) if t in own]
            if f.strongest in own:
                path = own[f.strongest]
                cells += [(magnified(f.root, path, a), f"alpha = {a:g}, t = {f.strongest}") for a in f.alphas]
            rows.append((f"test {name}: as captured, then the ground truth magnified", cells))
    if f.train is not None:
        first = [path for path, t in zip(f.train.paths, f.train.timesteps, strict=True) if t == 0]
        shown = [(path, path.stem) for path in first[:_MOST_TRAIN]]
        heading = f"training cameras at timestep 0 ({len(shown)} of {len(first)})"
        for i in range(0, len(shown), _ACROSS):
            rows.append(("" if i else heading, shown[i : i + _ACROSS]))
    return _drawn(rows, f.any.width / f.any.height)


def _drawn(rows: list[tuple[str, list[tuple[Path, str]]]], aspect: float) -> Image.Image:
    width, height = (_EDGE, round(_EDGE / aspect)) if aspect >= 1 else (round(_EDGE * aspect), _EDGE)
    font, bold = (ImageFont.load_default(size) for size in (12, 14))
    across = max(len(cells) for _, cells in rows)
    total = sum(height + _LABEL + _GAP + (26 if heading else 0) for heading, _ in rows) + _GAP
    made = Image.new("RGB", (across * (width + _GAP) + _GAP, total), "white")
    draw = ImageDraw.Draw(made)
    y = _GAP
    for heading, cells in rows:
        if heading:
            draw.text((_GAP, y + 4), heading, "black", bold)
            y += 26
        for i, (path, label) in enumerate(cells):
            x = _GAP + i * (width + _GAP)
            if path.is_file():
                pixels = Image.fromarray((read_picture(path) * 255 + 0.5).astype(np.uint8))
                made.paste(pixels.resize((width, height), Image.Resampling.LANCZOS), (x, y))
            else:
                draw.rectangle((x, y, x + width - 1, y + height - 1), outline="gray")
                draw.text((x + 8, y + height // 2 - 8), "absent", "gray", font)
            draw.text((x + 1, y + height + 2), label, "gray", font)
        y += height + _LABEL + _GAP
    return made
