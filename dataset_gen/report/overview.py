"""A page of all datasets in a folder: a picture of each with a link to its report, and one row each."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from tg4mm import __version__
from tg4mm.core.pages import page
from tg4mm.core.pages.svg import number, size_text
from tg4mm.core.records import read_formed
from tg4mm.core.values import Just, Maybe

from ..errors import GenerateError
from .dataset import decibel, hertz, percent, read_picture
from .write import FORMAT, save

_SCORE = {"alpha": float, **dict.fromkeys(("still_psnr_db", "perfect_psnr_db"), Maybe(float))}
_SUMMARY = {
    "format": Just(FORMAT), "scene": str, "frequencies_hz": [Maybe(float)], "amplitude": float, "bytes": int,
    "scores": [_SCORE], **dict.fromkeys(("pixels_max", "pixels_p95", "still_area"), Maybe(float)),
}  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """One dataset of the folder."""

    root: Path
    summary: dict[str, Any]  # {} if it has no report

    @property
    def name(self) -> str:
        return str(self.summary.get("scene", self.root.name))


def write_overview(parent: Path) -> Path:
    """See `dataset_gen.report.write_overview`."""
    roots = sorted(path.parent for path in parent.glob("*/scene.json"))
    if not roots:
        raise GenerateError(f"{parent}: holds no dataset, a folder with a scene.json")
    text = page.render_page(overview([Entry(root, _summary(root)) for root in roots]))
    save(parent / "index.html", lambda path: path.write_text(text, encoding="utf-8"))
    return parent / "index.html"


def overview(entries: list[Entry]) -> page.Page:
    """The page."""
    caption = "A training view of each; its name leads to its report."
    grid = page.Figure([_panel(entry) for entry in entries], caption, 4)
    return page.Page(
        title="Vibrating scenes with exact motion",
        kicker="vibration datasets, an overview",
        summary=f"{_count(len(entries))} in this folder, with cameras, pictures and exact ground truth.",
        stats=_stats(entries),
        lead=[],
        sections=[page.Section("The scenes", [grid, _table(entries), *_unreported(entries)])],
        footer=f"tg4mm {__version__}. Written from the reports of the sets.",
    )


def _count(n: int) -> str:
    return "One dataset" if n == 1 else f"{n} datasets"


def _summary(root: Path) -> dict[str, Any]:
    """{} where there is none, or none that `write_report` wrote: it can be written again."""
    try:
        return read_formed(root / "report/summary.json", _SUMMARY)
    except (OSError, ValueError):
        return {}


def _stats(entries: list[Entry]) -> list[page.Stat]:
    known = [e.summary for e in entries if e.summary]
    pixels = [s["pixels_max"] for s in known if s["pixels_max"]]
    value, unit = size_text(sum(s["bytes"] for s in known)).split(" ")
    stats = [
        page.Stat("Sets", str(len(entries))),
        page.Stat("On disk", value, unit, "equal pictures counted once"),
    ]
    if pixels:
        between = f"{number(min(pixels), 2)} … {number(max(pixels), 2)}"
        stats.insert(1, page.Stat("Largest motion in a picture", between, "px", "from set to set, at α = 0"))
    return stats


def _panel(entry: Entry) -> page.Panel:
    path = entry.root / "report/thumbnail.png"
    link = _link(entry)
    if not path.is_file():
        return page.missing("no report yet", link)
    try:
        return page.picture(read_picture(path), link, alt=entry.name)
    except GenerateError:
        return page.missing("its picture cannot be read", link)


def _link(entry: Entry) -> str:
    if not entry.summary:
        return entry.root.name
    href = f"{quote(entry.root.name)}/report/index.html"
    return Markup('<a href="{}" style="color: inherit">{}</a>').format(href, entry.root.name)


def _table(entries: list[Entry]) -> page.Table:
    rows = [_row(entry) for entry in entries if entry.summary]
    caption = (
        "Frequencies of the modes; largest displacement of any vertex; largest motion in a test picture and its 95th "
        "percentile over what moves; share of the surface that stands still; and, at the largest α, the PSNR of "
        "nothing moving (with noise of its own) and of a perfect method, limited by the noise of the truth alone."
    )
    header = [
        "set", "frequency", "amplitude (units)", "max (px)", "95 % (px)", "still", "α", "nothing moves",
        "perfect",
    ]  # fmt: skip
    return page.Table(header, rows, caption)


def _row(entry: Entry) -> list[str]:
    s = entry.summary
    score = s["scores"][-1] if s["scores"] else {}
    still = score.get("still_psnr_db")
    return [
        _link(entry), hertz([f for f in s["frequencies_hz"] if f] or [0.0]), number(s["amplitude"]),
        _number(s["pixels_max"]), _number(s["pixels_p95"]),
        "–" if s["still_area"] is None else percent(s["still_area"]),
        "–" if not score else f"{score['alpha']:g}", decibel(still), decibel(score.get("perfect_psnr_db")),
    ]  # fmt: skip


def _number(value: float | None) -> str:
    return "–" if value is None else number(value)


def _unreported(entries: list[Entry]) -> list[page.Text]:
    names = [entry.root.name for entry in entries if not entry.summary]
    if not names:
        return []
    return [page.Text(f"Without a report that can be read: {', '.join(names)}.", style="note")]
