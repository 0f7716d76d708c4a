"""What a scene needs to show its splats as they are: colour management, samples, bounces; and its way back."""

from __future__ import annotations

from typing import Any

from .. import compat, names
from . import scene
from .materials import TRANSPARENT_BOUNCES
from .shapes import DRAW_MODES

BEFORE = "tg4mm_before"  # custom property of a scene: what it had, by path
SAMPLES = 64  # of Blender's own splats: with 4 Cycles is 6 dB farther off
_LABELS = {
    "view_settings.view_transform": "view transform",
    "view_settings.look": "look",
    "view_settings.exposure": "exposure",
    "view_settings.gamma": "gamma",
    "cycles.transparent_max_bounces": "Cycles' transparent bounces",
    "cycles.min_transparent_bounces": "",
    "cycles.samples": "Cycles' samples",
    "eevee.taa_render_samples": "EEVEE's samples",
    "display.render_aa": "Workbench's samples",
    "display.shading.light": "Workbench's light",
}


def true_colours(to: Any, as_trained: bool | None = None) -> str:
    """Set a scene up for its splats, and how they blend.

    `as_trained`: colours blend as the screen shows them (view transform Raw), else in linear light (Standard); None: as
    the scene's splats do. Returns what to tell about it, "" where nothing had to be set. `restore` takes it back.
    """
    if as_trained is None:
        as_trained = blends_as_trained(to)
    for obj in _splats(to):
        modifier = scene.splat_modifier(obj)
        compat.set_input(modifier, names.BLEND, as_trained)
        drawn = compat.get_input(modifier, names.DRAW)
        # Blended so, Blender's own splats have one colour for all directions: the one that the camera sees.
        if as_trained and DRAW_MODES[drawn].native and compat.has_input(modifier, names.VIEW_COLOUR):
            compat.set_input(modifier, names.VIEW_COLOUR, True)
    return _set(to, _needed(to))


def restore(to: Any) -> str:
    """Give a scene back what it had before `true_colours`, with splats that blend in linear light."""
    for obj in _splats(to):
        compat.set_input(scene.splat_modifier(obj), names.BLEND, False)
    before = dict(to.get(BEFORE, {}))
    told = _set(to, before)
    if before:
        del to[BEFORE]
    return told


def is_set_up(of: Any) -> bool:
    """True where `true_colours` has nothing to set."""
    return not _needed(of)


def blends_as_trained(of: Any) -> bool:
    """True for a scene with splats that blend as trained."""
    return any(compat.get_input(scene.splat_modifier(obj), names.BLEND) for obj in _splats(of))


def _needed(of: Any) -> dict[str, Any]:
    """Path → value of what has to be set. Samples and bounces are never made fewer."""
    exact = {
        "view_settings.view_transform": "Raw" if blends_as_trained(of) else "Standard",
        "view_settings.look": "None",
        "view_settings.exposure": 0.0,
        "view_settings.gamma": 1.0,
    }
    least = dict.fromkeys(
        ("cycles.transparent_max_bounces", "cycles.min_transparent_bounces"), TRANSPARENT_BOUNCES
    )
    drawn = {compat.get_input(scene.splat_modifier(obj), names.DRAW) for obj in _splats(of)}
    if any(DRAW_MODES[name].native for name in drawn):
        least |= dict.fromkeys(("cycles.samples", "eevee.taa_render_samples"), SAMPLES)
        exact |= {"display.render_aa": "32", "display.shading.light": "FLAT"}
    now = {path: _get(of, path) for path in _LABELS}
    wrong = {path: value for path, value in exact.items() if now[path] not in (None, value)}
    few = {path: n for path, n in least.items() if now[path] is not None and now[path] < n}
    return wrong | few


def _set(to: Any, wanted: dict[str, Any]) -> str:
    """Set what is at the paths, remember what was there, and say it."""
    before, told = dict(to.get(BEFORE, {})), []
    for path, value in wanted.items():
        was, (*way, last) = _get(to, path), path.split(".")
        if was is None or was == value:
            continue
        holder = to
        for name in way:
            holder = getattr(holder, name)
        setattr(holder, last, value)
        before.setdefault(path, was)
        if label := _LABELS[path]:
            told.append(f"{label} set from {_text(was)} to {_text(value)}")
    if before:
        to[BEFORE] = before
    return ", ".join(told)


def _get(of: Any, path: str) -> Any:
    """What is at a path; None where there is no such thing: Cycles may be switched off in this Blender."""
    for name in path.split("."):
        of = getattr(of, name, None)
    return of


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _splats(of: Any) -> list[Any]:
    """The splat objects of a scene; not those of an older version, which cannot blend as trained."""
    modifiers = ((obj, scene.splat_modifier(obj)) for obj in of.objects)
    return [
        obj
        for obj, modifier in modifiers
        if modifier is not None and modifier.node_group and compat.has_input(modifier, names.BLEND)
    ]
