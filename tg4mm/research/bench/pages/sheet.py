"""Labelled pictures under each other as one PNG: figures for a paper."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tg4mm.core.files import write_atomic

_WIDTH = 720  # of every picture, pixels
_LABEL = 22


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
    for label, picture in pictures.items():
        draw.text((2, top + 3), label, fill=(27, 29, 33), font=font)
        sheet.paste(picture, (0, top + _LABEL))
        top += picture.height + _LABEL
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out, lambda temporary: sheet.save(temporary, "PNG"))


def _font() -> ImageFont.FreeTypeFont:
    """matplotlib's own, which has Greek letters; Pillow's has none."""
    import matplotlib

    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", 13)
