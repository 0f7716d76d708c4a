"""A run as one HTML file: template, style, program, scene and numbers put together."""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from tg4mm import __version__
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_atomic
from tg4mm.core.progress import progress
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run
from tg4mm.show.web.factor import MotionFields, motion_fields
from tg4mm.show.web.pack import pack
from tg4mm.show.web.scene import scene_json

_HERE = Path(__file__).parent
_PLAYER = _HERE / "player" / "dist"
_SUFFIXES = (".html", ".htm")


@dataclass(frozen=True)
class Page:
    """What goes into the template."""

    scene: dict[str, Any]
    block: bytes


def export_html(run: Run, out: Path) -> Path:
    """Write the run as one page that plays in a browser, from the file alone (docs/web.md).

    A run without motion gives a page of the still scene. Raises Tg4mmError for an `out` that is a folder, or a file
    that is no page; RunError for a run without a space stage or whose dataset is gone; CaptureError for a bad one.
    """
    if out.is_dir():
        raise Tg4mmError(f"--out {out}: is a folder; expected a file such as {out / 'scene.html'}")
    if out.suffix.lower() not in _SUFFIXES:
        raise Tg4mmError(f"--out {out}: expected a name that ends in .html, as browsers need it")
    page = make_page(run)
    text = render(page)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return out


def make_page(run: Run) -> Page:
    """The scene and its numbers. Raises what `export_html` does of the run."""
    with progress("page", 4, unit="steps") as update:
        gaussians, motion = run.load_space(), run.load_motion()
        update(1)
        fields = _fields(motion, len(gaussians))
        update(2)
        packed = pack(gaussians, fields, None if motion is None else motion.appearance)
        update(3)
        scene = scene_json(run, gaussians, motion, fields, packed)
        update(4)
    return Page(scene, packed.block)


def _fields(motion: ModalMotion | None, n: int) -> MotionFields:
    if motion is None or not len(motion.freqs_hz):
        return MotionFields(np.zeros((0, n, 6), np.float32), np.zeros((0, 2)), np.zeros((0, 0), complex))
    return motion_fields(motion)


def render(page: Page) -> str:
    """The page as text. Its content security policy lets nothing in or out: only its own program runs."""
    style = (_HERE / "page.css").read_text(encoding="utf-8")
    program = (_PLAYER / "player.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
    digest = base64.b64encode(hashlib.sha256(program.encode()).digest()).decode()
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("page.html").render(
        title=page.scene["title"],
        version=__version__,
        style=Markup(style),
        program=Markup(program),
        program_hash=Markup(f"sha256-{digest}"),
        licences=(_PLAYER / "licences.txt").read_text(encoding="utf-8"),
        # Inside a script element only "<" could end it; \u003c is the same text to JSON.
        scene=Markup(json.dumps(page.scene, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")),
        block=Markup(base64.b64encode(page.block).decode("ascii")),
    )
