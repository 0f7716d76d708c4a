"""Pictures of the benchmark's pages: methods side by side, over time, as differences and space-time slices."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from PIL import Image, ImageDraw, ImageFont

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_atomic
from tg4mm.core.pages.page import Block, Figure, Section, Text, film, photo_uri, picture
from tg4mm.core.pictures.decode import to_bytes
from tg4mm.research.bench.jobs import picture_folder
from tg4mm.research.bench.scored import most_changing, video_of
from tg4mm.research.bench.sets import BenchSet, alpha_to_show, open_set, truth_at
from tg4mm.show.maps import difference_maps
from tg4mm.show.report.figures import (
    SliceLine,
    clip,
    line_that_moves,
    map_picture,
    marked,
    playing_rate,
    slice_picture,
)

TRUTH = "ground truth"
_MAPS = 6  # of the first seven frames, as [TG4MM] Fig. 4
_SLICE_HEIGHT = 96  # in the file, pixels
_REPEATS = 24  # pictures that a slice shows at least
_WIDTH = 720  # of every picture, pixels
_LABEL = 22


@dataclass(frozen=True)
class ShownView:
    """One test view of a set at one α, by every row."""

    label: str  # of the set
    alpha: int
    view: str  # its file's name
    fps: float
    videos: dict[str, np.ndarray]  # row → [T, H, W, 3] float32; the ground truth first


def shown_sections(out: Path, results: Mapping[str, Any], group: str) -> Iterator[Section]:
    """A section for each set of the group; of one that cannot be read any more it says why.

    Beside it OUT/figures/<set>_slices.png and <set>_differences.png, as [TG4MM] Fig. 3 and 4.
    """
    for data in results["sets"]:
        if data["group"] == group:
            try:
                shown = gather(out, results, open_set(Path(data["root"]), data["label"]))
            except Tg4mmError as error:
                yield Section(data["label"], [Text(f"No pictures: {error}", "note")])
                continue
            if len(shown.videos) > 1:
                _write_figures(out / "figures", shown)
                yield Section(f"{data['label']} at α = {shown.alpha}", list(_blocks(shown)))


def gather(out: Path, results: Mapping[str, Any], data: BenchSet) -> ShownView:
    """The view whose ground truth changes most, at an α that as many rows as possible have."""
    lines = [line for line in results["lines"] if line["set"] == data.label]
    counts = Counter(int(a) for line in lines for a in line["alphas"] if float(a) > 0)
    alphas = [a for a, n in counts.items() if n == max(counts.values())]  # an outside method may lack some
    alpha = alpha_to_show(alphas)
    capture = truth_at(data, alpha)
    rows, truth = most_changing(capture)
    videos = {TRUTH: truth}
    for line in lines:
        if f"{alpha:g}" in line["alphas"]:
            folder = picture_folder(out / "runs" / data.label / line["method"], line["row"])
            videos[line["row"]] = video_of(capture, rows, folder)
    return ShownView(data.label, alpha, capture.paths[rows[0]].name, data.fps, videos)


def _blocks(s: ShownView) -> Iterator[Block]:
    yield Text(_slider(s), plain=True)
    frames = {row: to_bytes(video) for row, video in s.videos.items()}
    films = [film(clip(video, s.fps, edge=256), video[0], row) for row, video in frames.items()]
    seconds = len(s.videos[TRUTH]) / playing_rate(s.fps)
    yield Figure(films, f"Test view {s.view} over time, in step.", 4, controls=True, seconds=seconds)
    line, cut = _slices(s)
    height, width = frames[TRUTH].shape[1:3]
    shape = f"{width} / {height}"  # time is stretched: as tall as the picture beside them
    slices = [picture(marked(frames[TRUTH][0], line), "where the slices are cut", photo=True)]
    slices += [picture(piece, row, f"slice: {row}", True, shape) for row, piece in cut.items()]
    way = "to the right" if line.axis == "column" else "down"
    yield Figure(
        slices, f"Space-time slices of {line.axis} {line.index}, time runs {way} ([TG4MM] Fig. 3).", 4
    )
    yield _differences(s)


def _slices(s: ShownView) -> tuple[SliceLine, dict[str, np.ndarray]]:
    """Return [TG4MM] Fig. 3: where they are cut, and uint8 pictures."""
    line = line_that_moves(s.videos[TRUTH])
    periods = -(-_REPEATS // len(s.videos[TRUTH]))
    return line, {row: slice_picture(to_bytes(video), line, periods) for row, video in s.videos.items()}


def _maps(s: ShownView) -> tuple[dict[str, np.ndarray], float, int]:
    """Return [TG4MM] Fig. 4, changes from frame to frame side by side as uint8 pictures, with scale and number."""
    n = min(_MAPS, len(s.videos[TRUTH]) - 1)
    maps = {row: difference_maps(video, n) for row, video in s.videos.items()}
    top = maps[TRUTH][1]
    strips = {row: np.concatenate(list(found), axis=1).clip(0, top) for row, (found, _) in maps.items()}
    return {row: map_picture(strip, top) for row, strip in strips.items()}, top, n


def _write_figures(folder: Path, s: ShownView) -> None:
    def titled(pictures: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {f"{row}, α = {s.alpha}" if row == TRUTH else row: p for row, p in pictures.items()}

    write_sheet(folder / f"{s.label}_slices.png", titled(_slices(s)[1]), _SLICE_HEIGHT)
    write_sheet(folder / f"{s.label}_differences.png", titled(_maps(s)[0]))


def _differences(s: ShownView) -> Figure:
    maps, top, n = _maps(s)
    strips = [picture(strip, row, f"difference maps: {row}", True) for row, strip in maps.items()]
    caption = (
        f"Difference maps |I(t + 1) − I(t)| of the first {n + 1} frames ([TG4MM] Eq. 17), all from 0 to {top:.3f}, the "
        "ground truth's largest."
    )
    return Figure(strips, caption, 2)


def _slider(s: ShownView) -> Markup:
    """Two rows laid over each other with an edge to move, where the ground truth is farthest from its mean."""
    truth = s.videos[TRUTH]
    t = int(((truth - truth.mean(0)) ** 2).mean((1, 2, 3)).argmax())
    sources = {row: photo_uri(video[t]) for row, video in s.videos.items()}
    rows = list(sources)
    second = rows[2] if len(rows) > 2 else rows[-1]
    options = {
        side: Markup("").join(
            Markup('<option value="{}"{}>{}</option>').format(
                sources[row], Markup(" selected") if row == chosen else "", row
            )
            for row in rows
        )
        for side, chosen in (("left", TRUTH), ("right", second))
    }
    height, width = truth.shape[1:3]
    return Markup(
        '<figure class="compare"><div class="pair" style="aspect-ratio: {w} / {h}"><img data-side="right" src="{b}" '
        'alt="right picture"><img data-side="left" src="{a}" alt="left picture"></div><div class="controls">'
        '<label>left <select data-pick="left">{left}</select></label>'
        '<input type="range" data-edge min="0" max="100" value="50" aria-label="Where the left picture ends, percent">'
        '<label>right <select data-pick="right">{right}</select></label></div>'
        "<figcaption>Test view {view}, timestep {t}. Move the edge to compare.</figcaption></figure>"
    ).format(w=width, h=height, a=sources[TRUTH], b=sources[second], view=s.view, t=t, **options)


def write_sheet(out: Path, rows: Mapping[str, np.ndarray], height: int = 0) -> None:
    """Write {label: uint8 [H, W, 3 | 4]}, each as wide as the sheet and `height` pixels high; 0: as its shape asks."""
    pictures = {
        label: Image.fromarray(pixels)
        .convert("RGB")
        .resize(
            (_WIDTH, height or round(_WIDTH * pixels.shape[0] / pixels.shape[1])), Image.Resampling.NEAREST
        )
        for label, pixels in rows.items()
    }
    sheet = Image.new("RGB", (_WIDTH, sum(p.height + _LABEL for p in pictures.values()) + 4), "white")
    draw, font, top = ImageDraw.Draw(sheet), _font(), 0
    for label, one in pictures.items():
        draw.text((2, top + 3), label, fill=(27, 29, 33), font=font)
        sheet.paste(one, (0, top + _LABEL))
        top += one.height + _LABEL
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out, lambda temporary: sheet.save(temporary, "PNG"))


def _font() -> ImageFont.FreeTypeFont:
    import matplotlib

    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", 13)
