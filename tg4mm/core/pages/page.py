"""The parts of a page, and the page as one self-contained HTML file."""

import base64
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup
from PIL import Image

from tg4mm.core.pages.charts import zoom_script, zoom_style
from tg4mm.core.pictures.decode import png_bytes, to_bytes

_HERE = Path(__file__).parent
PHOTO_EDGE = 800  # pixels
_LEAST_EDGE = 512  # pixels, of what is enlarged smoothly
Inline = str | Markup


@dataclass(frozen=True)
class Stat:
    """A headline figure."""

    label: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class FigurePanel:
    """A picture, a video or a drawing inside a figure."""

    kind: str  # "img", "video", "svg" or "missing"
    label: str = ""
    source: str = ""  # data URI of an image or video
    still: str = ""  # data URI of the picture that is printed in place of a video
    drawing: Markup = field(default_factory=Markup)
    alt: str = ""
    style: str = ""  # CSS classes: crisp (enlarge with sharp pixels), bare (no ground of its own)
    shape: str = ""  # CSS aspect-ratio, "" = the picture's own


@dataclass(frozen=True)
class Figure:
    """Panels side by side over one caption. `legend` is a drawing under them, for example a colour bar."""

    panels: Sequence[FigurePanel]
    caption: Inline
    columns: int = 0  # 0 = as many as there are panels
    legend: Markup = field(default_factory=Markup)
    controls: bool = False  # buttons to pause and slow the videos
    seconds: float = 0.0  # what the videos show once, for a slider; 0: no slider
    width: str = "wide"  # "wide", "narrow" as the text, or "small"
    kind: str = "figure"


@dataclass(frozen=True)
class Table:
    """Rows of text; the first column heads its row."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: Inline
    styles: Sequence[str] = ()  # CSS class of each row
    left: int = 1  # how many leading columns are flush left
    kind: str = "table"


@dataclass(frozen=True)
class Text:
    """A paragraph; `style` "note" sets it apart. `plain`: markup that is a block of its own, such as a list."""

    words: Inline
    style: str = ""
    plain: bool = False
    kind: str = "text"


@dataclass(frozen=True)
class Commands:
    """Commands to copy, each with what it does."""

    lines: Sequence[tuple[str, str]]
    kind: str = "commands"


Block = Figure | Table | Text | Commands


@dataclass(frozen=True)
class Section:
    """A numbered section."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A whole report."""

    title: str
    kicker: str
    summary: Inline
    stats: Sequence[Stat]
    lead: Sequence[Block]  # between the headline figures and the first section
    sections: Sequence[Section]
    footer: Inline


def data_uri(kind: str, data: bytes) -> str:
    """`data` as a data: URI of the media type `kind`."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def photo_uri(image: np.ndarray) -> str:
    """Encode a picture [H, W, 3 | 4], uint8 or float in 0..1, as lossy WebP.

    Large pictures are reduced, small ones enlarged.
    """
    one = Image.fromarray(image if image.dtype == np.uint8 else to_bytes(image))
    scale = _LEAST_EDGE // max(one.size)
    if scale > 1:  # what shows it would repeat its pixels
        one = one.resize((one.width * scale, one.height * scale), Image.Resampling.BICUBIC)
    one.thumbnail((PHOTO_EDGE, PHOTO_EDGE), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    one.save(buffer, "WEBP", quality=85)
    return data_uri("image/webp", buffer.getvalue())


def picture(
    image: np.ndarray,
    label: str = "",
    alt: str = "",
    crisp: bool = False,
    shape: str = "",
    photo: bool = False,
) -> FigurePanel:
    """A panel with a picture, uint8 or float in 0..1, [H, W, 3 | 4]; `crisp` enlarges with sharp pixels.

    `photo`: compressed with loss, and made no larger than a screen shows it.
    """
    source = photo_uri(image) if photo else data_uri("image/png", png_bytes(image))
    styles = [name for name, wanted in (("crisp", crisp), ("bare", image.shape[-1] == 4)) if wanted]
    return FigurePanel("img", label, source, alt=alt or label, style=" ".join(styles), shape=shape)


def film(mp4: bytes, still: np.ndarray, label: str = "", alt: str = "") -> FigurePanel:
    """A panel with a video; `still` is the picture that is printed in its place."""
    height, width = still.shape[:2]
    return FigurePanel(
        "video",
        label,
        data_uri("video/mp4", mp4),
        photo_uri(still),
        alt=alt or label,
        shape=f"{width} / {height}",
    )


def drawing(svg: Markup, label: str = "") -> FigurePanel:
    """A panel with an inline SVG."""
    return FigurePanel("svg", label, drawing=svg)


def missing(reason: str, label: str = "") -> FigurePanel:
    """A panel that says why there is nothing to see."""
    return FigurePanel("missing", label, alt=reason)


def render_page(page: Page, more_style: str = "", more_script: str = "") -> str:
    """The page as one HTML document without anything to load; CSS and JavaScript may be added."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # Our own files, not data: they go in as they are.
    style, script = (Markup((_HERE / name).read_text(encoding="utf-8")) for name in ("style.css", "sync.js"))
    style, script = style + Markup(more_style), script + Markup(more_script)
    template = environment.get_template("template.html")
    zooms = any('class="curves"' in panel.drawing for panel in _panels(page))
    if zooms:
        style, script = style + Markup(zoom_style()), script + Markup(zoom_script())
    return template.render(page=page, style=style, script=script)


def _panels(page: Page) -> Iterator[FigurePanel]:
    for block in (*page.lead, *(block for section in page.sections for block in section.blocks)):
        if isinstance(block, Figure):
            yield from block.panels
