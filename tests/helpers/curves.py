"""The points of curves that `tg4mm.research.bench.pages.plots` drew."""

import re
from xml.etree import ElementTree


def points_of(svg: str) -> dict[str, list[tuple[float, float]]]:
    """Points of every curve in user units, x to the right and y down, by its name and number."""
    found = {}
    for group in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}g"):
        if (name := group.get("id", "")).startswith("curve: "):
            numbers = [float(n) for n in re.findall(r"-?[\d.]+", group[0].get("d", ""))]
            found[name.removeprefix("curve: ")] = list(zip(numbers[::2], numbers[1::2], strict=True))
    return found
