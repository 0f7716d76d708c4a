"""The kinds of modes that the panel offers: which settings each has, and the description they make."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple


class Row(NamedTuple):
    """One key of a kind in a motion description."""

    key: str  # of the description
    setting: str  # of the panel's settings
    text: str  # beside the field
    read: Callable[[Any], Any]
    shown: Callable[[Any], bool] = lambda _: True  # by the settings


class Kind(NamedTuple):
    label: str
    description: str
    rows: tuple[Row, ...]


def _vector(value: Any) -> list[float]:
    # Blender keeps float32: 0.1 would become 0.10000000149 in the description.
    return [_number(x) for x in value]


def _number(value: Any) -> float:
    return float(f"{value:.7g}")


def _positive_or_none(value: Any) -> float | None:
    return _number(value) if value > 0 else None


def _whole(value: Any) -> int:
    return int(value)


def _pair(value: Any) -> list[int]:
    return [int(x) for x in value]


def _point(key: str, text: str) -> Row:
    return Row(key, "point", text, _vector)


_DIRECTION = Row("direction", "direction", "Direction", _vector)
_AXIS = Row("axis", "axis", "Axis", _vector)
_NORMAL = Row("normal", "axis", "Normal", _vector)
_THICKNESS = Row("thickness", "thickness", "Thickness", _positive_or_none)

KINDS: dict[str, Kind] = {
    "translate": Kind("Translate", "Everything moves alike", (_DIRECTION,)),
    "rock": Kind("Rock", "Turns to and fro about an axis", (_point("pivot", "Pivot"), _AXIS)),
    "twist": Kind(
        "Twist",
        "Turns about an axis, more the farther along it",
        (_point("pivot", "Pivot"), _AXIS, Row("length", "length", "Length", _positive_or_none)),
    ),
    "bending": Kind(
        "Bending",
        "A beam clamped at its base (Euler and Bernoulli)",
        (
            _point("base", "Base"),
            Row("tip", "tip", "Tip", _vector),
            _DIRECTION,
            Row("order", "order", "Order", _whole),
        ),
    ),
    "wave": Kind(
        "Wave",
        "A wave that travels through the objects",
        (
            Row("direction", "direction", "Travels Along", _vector),
            Row("wavelength", "wavelength", "Wavelength", _number),
            Row("polarisation", "rayleigh", "Rayleigh", lambda on: "rayleigh" if on else None),
            Row("polarisation", "axis", "Moves Along", _vector, lambda s: not s.rayleigh),
            Row("decay_length", "decay_length", "Decay Length", _positive_or_none),
            Row("level", "level", "Surface z", _number),
        ),
    ),
    "jiggle": Kind(
        "Jiggle",
        "A soft body, held at a height or at a point",
        (
            Row("held", "hold", "Held", lambda _: None),
            Row("held", "level", "Height z", _number, lambda s: s.hold == "HEIGHT"),
            Row("held", "point", "Point", _vector, lambda s: s.hold == "POINT"),
            Row("reach", "reach", "Reach", _number),
            Row("direction", "random", "Random Direction", lambda on: "random" if on else None),
            Row("direction", "direction", "Direction", _vector, lambda s: not s.random),
        ),
    ),
    "membrane": Kind(
        "Membrane",
        "A drum skin",
        (
            _point("centre", "Centre"),
            _NORMAL,
            Row("radius", "radius", "Radius", _number),
            Row("nodes", "drum_nodes", "Nodal Lines, Circles", _pair),
            _THICKNESS,
        ),
    ),
    "plate": Kind(
        "Plate",
        "A rectangle supported along its edge",
        (
            _point("centre", "Centre"),
            _NORMAL,
            Row("x", "direction", "First Side Along", _vector),
            Row("size", "sides", "Sides", _vector),
            Row("nodes", "plate_nodes", "Half Waves", _pair),
            _THICKNESS,
        ),
    ),
    "group": Kind(
        "Vertex Group",
        "The weights of a vertex group times a direction",
        (Row("group", "group", "Vertex Group", str), _DIRECTION),
    ),
}


def rows(settings: Any) -> list[Row]:
    """The rows of the settings' kind that are shown."""
    return [row for row in KINDS[settings.kind].rows if row.shown(settings)]


def mode(settings: Any, parts: list[str]) -> dict[str, Any]:
    """The mode as a motion description has it; `parts`: globs of what moves, empty for everything."""
    data: dict[str, Any] = {"name": settings.kind, "kind": settings.kind}
    data["frequency"] = _number(settings.frequency)
    in_pixels = settings.amplitude_in == "PIXELS"
    data["amplitude_px" if in_pixels else "amplitude"] = _number(
        settings.amplitude_px if in_pixels else settings.amplitude
    )
    for row in rows(settings):
        value = row.read(getattr(settings, row.setting))
        if value is not None:
            data[row.key] = value
    if settings.phase:
        data["phase"] = _number(settings.phase * 57.29577951308232)
    if parts:
        data["parts"] = parts
    return data
