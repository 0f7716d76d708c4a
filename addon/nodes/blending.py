"""How a scene's splats blend, in linear light or as trained, and the colour management that goes with it."""

from __future__ import annotations

from typing import Any

from .. import compat, names
from . import scene
from .materials import TRANSPARENT_BOUNCES


def true_colours(to: Any, as_trained: bool | None = None) -> str:
    """Set a scene's colour management, how its splats blend, and Cycles' transparent bounces.

    `as_trained`: colours blend as the screen shows them (view transform Raw), else in linear light (Standard); None: as
    the scene's splats do now. Returns what to tell about it, "" where the view transform was that one before.
    """
    if as_trained is None:
        as_trained = blends_as_trained(to)
    for obj in _splats(to):
        compat.set_input(scene.splat_modifier(obj), names.BLEND, as_trained)
    before, transform = to.view_settings.view_transform, view_transform(to)
    to.view_settings.view_transform, to.view_settings.look = transform, "None"
    to.view_settings.exposure, to.view_settings.gamma = 0.0, 1.0
    # Cycles may be switched off in this Blender.
    if hasattr(to, "cycles"):
        cycles = to.cycles
        cycles.transparent_max_bounces = max(cycles.transparent_max_bounces, TRANSPARENT_BOUNCES)
        cycles.min_transparent_bounces = max(cycles.min_transparent_bounces, TRANSPARENT_BOUNCES)
    return "" if before == transform else f"view transform set from {before} to {transform}"


def blends_as_trained(of: Any) -> bool:
    """True for a scene with splats that blend as trained."""
    return any(compat.get_input(scene.splat_modifier(obj), names.BLEND) for obj in _splats(of))


def view_transform(of: Any) -> str:
    """The view transform that the colours of a scene's splats are made for."""
    return "Raw" if blends_as_trained(of) else "Standard"


def _splats(of: Any) -> list[Any]:
    """The splat objects of a scene; not those of an older version, which cannot blend as trained."""
    modifiers = ((obj, scene.splat_modifier(obj)) for obj in of.objects)
    return [
        obj
        for obj, modifier in modifiers
        if modifier is not None and modifier.node_group and compat.has_input(modifier, names.BLEND)
    ]
