"""The fields of each kind of vibration, and the motion description built from the settings."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import bpy

from dataset_gen.errors import GenerateError
from dataset_gen.vibration import MotionDescription, read_motion

# Settings that have another name than their key, and those that are left out of the description where they are 0.
_SETTINGS = {
    "pivot": "point",
    "base": "point",
    "centre": "point",
    "normal": "axis",
    "x": "direction",
    "size": "sides",
}
_OPTIONAL = ("length", "decay_length", "thickness")


class KindKey(NamedTuple):
    """One key of a vibration kind in a motion description."""

    key: str  # of the description
    setting: str  # of the panel's settings
    text: str  # beside the field
    shown: Callable[[Any], bool] = lambda _: True  # by the settings


class VibrationKind(NamedTuple):
    label: str
    description: str
    rows: tuple[KindKey, ...]


def _rows(keys: str, **texts: str) -> tuple[KindKey, ...]:
    """Rows of keys, with the texts of those that are not called as they are."""
    named = {key: texts.get(key, key.replace("_", " ").title()) for key in keys.split()}
    return tuple(KindKey(key, _SETTINGS.get(key, key), text) for key, text in named.items())


_POLARISATION = (
    KindKey("polarisation", "rayleigh", "Rayleigh"),
    KindKey("polarisation", "axis", "Moves Along", lambda s: not s.rayleigh),
)
_HELD = (
    KindKey("held", "hold", "Held"),
    KindKey("held", "level", "Height z", lambda s: s.hold == "HEIGHT"),
    KindKey("held", "point", "Point", lambda s: s.hold == "POINT"),
)
_SWAY = (
    KindKey("direction", "random", "Random Direction"),
    KindKey("direction", "direction", "Direction", lambda s: not s.random),
)
_DRUM, _PLATE = (
    KindKey("nodes", "drum_nodes", "Nodal Lines, Circles"),
    KindKey("nodes", "plate_nodes", "Half Waves"),
)
_PLACE, _THICKNESS = _rows("centre normal"), _rows("thickness")
KINDS: dict[str, VibrationKind] = {
    "translate": VibrationKind("Translate", "Everything moves by the same displacement", _rows("direction")),
    "rock": VibrationKind("Rock", "Rotates back and forth about an axis", _rows("pivot axis")),
    "twist": VibrationKind("Twist", "Twists about an axis: the angle grows along it", _rows("pivot axis length")),
    "bending": VibrationKind(
        "Bending", "A beam clamped at its base (Euler and Bernoulli)", _rows("base tip direction order")
    ),
    "wave": VibrationKind(
        "Wave", "A wave that travels through the objects",
        (*_rows("direction wavelength", direction="Travels Along"), *_POLARISATION,
         *_rows("decay_length level", level="Surface z")),
    ),
    "jiggle": VibrationKind("Jiggle", "A soft body, held at a height or at a point", (*_HELD, *_rows("reach"), *_SWAY)),
    "membrane": VibrationKind("Membrane", "A drum skin", (*_PLACE, *_rows("radius"), _DRUM, *_THICKNESS)),
    "plate": VibrationKind(
        "Plate", "A rectangle supported along its edge",
        (*_PLACE, *_rows("x size", x="First Side Along", size="Sides"), _PLATE, *_THICKNESS),
    ),
    "group": VibrationKind(
        "Vertex Group", "The weights of a vertex group times a direction",
        _rows("group direction", group="Vertex Group"),
    ),
}  # fmt: skip


def _number(value: Any) -> float:
    # Blender keeps float32: 0.1 would become 0.10000000149 in the description.
    return float(f"{value:.7g}")


def _read(row: KindKey, value: Any) -> Any:
    """Return the value of a key from that of its setting; None leaves it out."""
    if row.setting == "hold" or (row.setting in _OPTIONAL and not value > 0):
        return None
    if isinstance(value, bool):  # the word of that name in place of numbers
        return row.setting if value else None
    if isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return _number(value)
    return [int(x) if isinstance(x, int) else _number(x) for x in value]


def rows(settings: Any) -> list[KindKey]:
    """Return the visible rows of the selected kind."""
    return [row for row in KINDS[settings.kind].rows if row.shown(settings)]


def mode(settings: Any, parts: list[str]) -> dict[str, Any]:
    """Return the mode as a motion description; `parts` are globs of moving parts, empty for all."""
    data: dict[str, Any] = {"name": settings.kind, "kind": settings.kind}
    data["frequency"] = _number(settings.frequency)
    in_pixels = settings.amplitude_in == "PIXELS"
    data["amplitude_px" if in_pixels else "amplitude"] = _number(
        settings.amplitude_px if in_pixels else settings.amplitude
    )
    for row in rows(settings):
        value = _read(row, getattr(settings, row.setting))
        if value is not None:
            data[row.key] = value
    if settings.phase:
        data["phase"] = _number(settings.phase * 57.29577951308232)
    if parts:
        data["parts"] = parts
    return data


def description(settings: Any, parts: Sequence[str]) -> MotionDescription:
    """Return the motion description of the settings. Raises GenerateError."""
    if settings.source == "FILE":
        if not settings.motion_file:
            raise GenerateError("Description is empty: choose a motion description, or One Mode")
        return read_motion(Path(bpy.path.abspath(settings.motion_file)))
    return MotionDescription.from_json({"modes": [mode(settings, list(parts))]}, "panel")
