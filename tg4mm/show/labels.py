"""Labels on a picture that do not cover each other."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

_LETTER = 1 / 26  # of the shorter side: the height of a letter
_GAP = 4  # pixels between labels, and to the picture's edge
_TURNS, _RINGS = 16, 40  # places that are tried around a point, further and further away


def write_labels(picture: Image.Image, labels: Sequence[tuple[str, tuple[float, float]]]) -> None:
    """Write texts beside their points (x, y) in pixels, in white with a black edge, on an RGB picture.

    A label that would cover another one moves away as far as it has to, with a line to its point.
    """
    draw, size = ImageDraw.Draw(picture), max(12, round(_LETTER * min(picture.size)))
    font, taken = ImageFont.load_default(size), list[tuple[float, float, float, float]]()
    for text, point in labels:
        _, _, width, height = draw.textbbox((0, 0), text, font=font)
        box = _free((width, height), point, picture.size, taken, size)
        taken.append(box)
        middle = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2)
        if np.hypot(middle[0] - point[0], middle[1] - point[1]) > width / 2 + 2 * size:
            draw.line([point, middle], fill=(255, 255, 255), width=2)
        draw.text(box[:2], text, font=font, fill=(255, 255, 255), stroke_width=2, stroke_fill=(0, 0, 0))


def _free(
    size: tuple[float, float],
    point: tuple[float, float],
    picture: tuple[int, int],
    taken: Sequence[tuple[float, float, float, float]],
    step: float,
) -> tuple[float, float, float, float]:
    """Left, upper, right, lower of the nearest place that is free; the point's own where none is."""

    def at(x: float, y: float) -> tuple[float, float, float, float]:
        left = min(max(x + _GAP, _GAP), max(picture[0] - size[0] - _GAP, _GAP))
        upper = min(max(y + _GAP, _GAP), max(picture[1] - size[1] - _GAP, _GAP))
        return left, upper, left + size[0], upper + size[1]

    for ring in range(_RINGS):
        for turn in range(_TURNS if ring else 1):
            angle = 2 * np.pi * turn / _TURNS
            box = at(point[0] + ring * step * np.cos(angle), point[1] + ring * step * np.sin(angle))
            if not any(_overlap(box, other) for other in taken):
                return box
    return at(*point)


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] + _GAP and b[0] < a[2] + _GAP and a[1] < b[3] + _GAP and b[1] < a[3] + _GAP
