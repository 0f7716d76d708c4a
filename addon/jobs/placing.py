"""Places and sizes for a mode: from the box around the moving objects, or from the 3D cursor."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import objects

PLACES, HEADINGS, HEIGHTS = ("point", "tip"), ("axis", "direction"), ("level",)


def fit(settings: Any, low: np.ndarray, high: np.ndarray) -> None:
    """Set the fields of the settings' kind for a box of these corners [3]. ValueError for one without size."""
    size = high - low
    if not size.max() > 0:
        raise ValueError("the objects have no size")
    thin, middle, long = np.argsort(size, kind="stable")
    centre = 0.5 * (low + high)
    foot, top = centre.copy(), centre.copy()
    if settings.kind in ("bending", "twist"):
        foot[long], top[long] = low[long], high[long]
        _set(settings, axis=_unit(long), direction=_unit(thin), length=float(size[long]))
    elif settings.kind in ("membrane", "plate"):
        foot = centre
        sides = size[long], max(size[middle], 1e-6)
        _set(settings, axis=_unit(thin), direction=_unit(long), sides=sides, radius=0.5 * float(size[middle]))
    else:
        foot[2], top[2] = low[2], high[2]
        _set(settings, axis=_unit(1 if settings.kind == "rock" else 2))
    is_wave = settings.kind == "wave"
    wavelength = 0.5 * float(size.max())
    _set(settings, point=foot, tip=top, wavelength=wavelength, level=float((high if is_wave else low)[2]))
    _set(settings, reach=float(max(size[2], 1e-6)))


def chosen(context: Any) -> list[Any]:
    """What a box is taken around: the moving objects; without any the active object; else all that is shown."""
    settings = context.scene.tg4mm_generate
    moving = objects.moving(settings, context.scene)
    if moving:
        return moving
    active = context.object
    return [active] if active is not None else objects.previewed(context.view_layer)


def from_cursor(settings: Any, name: str, cursor: Any) -> None:
    """Set one field: a place to the cursor's, a heading to its z axis, a height to its z."""
    if name in PLACES:
        setattr(settings, name, cursor.matrix.translation)
    elif name in HEADINGS:
        setattr(settings, name, cursor.matrix.col[2][:3])
    elif name in HEIGHTS:
        setattr(settings, name, cursor.matrix.translation[2])
    else:
        raise ValueError(f"{name!r} is none of {', '.join((*PLACES, *HEADINGS, *HEIGHTS))}")


def _set(settings: Any, **values: Any) -> None:
    for name, value in values.items():
        setattr(settings, name, value)


def _unit(axis: int) -> tuple[float, ...]:
    return tuple(np.eye(3)[axis].tolist())
