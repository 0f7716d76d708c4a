"""Pictures in panels: drawn by pure functions when a panel first asks for them, kept as icons.

A panel's draw() may change nothing. It asks `icon(function, *arguments)`; what is not there yet is drawn by a timer
right after, and the panel is drawn again. The same arguments need no second drawing: a picture changes when, and
only when, what it shows does, whatever changed that (a slider, a key, a driver, undo, another object).
"""

import time
from collections.abc import Callable, Hashable
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

MOST = 16  # pictures kept; more than panels show at a time
_TOLD_OFF = 0.0  # s, between the panel's wish and the drawing
_IN_PLAYBACK = 0.2  # s at least between two drawings of the sidebar, which would slow playback down

Key = tuple[Hashable, ...]


class Icons:
    """The extension's icons and their contents, from `register` to `unregister`."""

    def __init__(self) -> None:
        self._previews = bpy.utils.previews.new()
        self._free = [f"picture {i}" for i in range(MOST)]
        self._names: dict[Key, str] = {}  # the longest unused first
        self._wanted: dict[Key, None] = {}
        self._last: dict[Hashable, Key] = {}  # of each function, what was shown last

    def icon(self, function: Callable[..., np.ndarray], *arguments: Hashable) -> int:
        """Return the icon's id, or the previous picture's while it is not drawn yet, or 0."""
        key: Key = (function, *arguments)
        if key not in self._names:
            self._wanted[key] = None
            key = self._last.get(function, key)
        if key not in self._names:
            return 0
        self._names[key] = self._names.pop(key)
        return self._previews[self._names[key]].icon_id

    @property
    def waiting(self) -> int:
        """Return the number of requested pictures that are not drawn yet."""
        return len(self._wanted)

    def refresh(self) -> None:
        """Draw the requested pictures."""
        wanted, self._wanted = self._wanted, {}
        for key in list(wanted)[-MOST:]:
            self._put(key, key[0](*key[1:]))  # type: ignore[operator]

    def pixels(self, function: Callable[..., np.ndarray], *arguments: Hashable) -> np.ndarray | None:
        """Return an icon's pixels [H, W, 4], uint8, row 0 at the top, or None if it is not drawn yet."""
        name = self._names.get((function, *arguments))
        if name is None:
            return None
        preview = self._previews[name]
        width, height = preview.image_size
        flat = np.empty(width * height, np.int32)
        preview.image_pixels.foreach_get(flat)
        return flat.view(np.uint8).reshape(height, width, 4)[::-1]

    def close(self) -> None:
        bpy.utils.previews.remove(self._previews)

    def _put(self, key: Key, picture: np.ndarray) -> None:
        if self._free:
            name = self._free.pop()
            self._previews.new(name)
        else:
            name = self._names.pop(next(iter(self._names)))
        preview = self._previews[name]
        preview.image_size = picture.shape[1], picture.shape[0]
        rows = np.ascontiguousarray((picture[::-1] * 255 + 0.5).clip(0, 255).astype(np.uint8))
        preview.image_pixels.foreach_set(rows.view(np.int32).ravel())
        self._names[key], self._last[key[0]] = name, key


_pictures: Icons | None = None
_drawn_at = 0.0


def icon(function: Callable[..., np.ndarray], *arguments: Hashable) -> int:
    """Return `Icons.icon` and schedule the drawing of missing pictures."""
    assert _pictures is not None, "the extension is not registered"
    number = _pictures.icon(function, *arguments)
    if _pictures.waiting and not bpy.app.timers.is_registered(_refresh):
        bpy.app.timers.register(_refresh, first_interval=_TOLD_OFF)
    return number


def prepare(function: Callable[..., np.ndarray], *arguments: Hashable) -> None:
    """Draw a picture now, before a panel requests it. Must not be called while a panel is drawn."""
    number = shared().icon(function, *arguments)
    if not number or shared().waiting:
        shared().refresh()


def shared() -> Icons:
    """Return the extension's pictures."""
    assert _pictures is not None, "the extension is not registered"
    return _pictures


def draw(layout: Any, width: float, function: Callable[..., np.ndarray], *arguments: Hashable) -> None:
    """Draw a square picture in a panel, `width` in units of a button's height."""
    layout.template_icon(icon_value=icon(function, *arguments), scale=width)


def fitting_width(context: Any, most: float = 11.0) -> float:
    """Return the width, in units of a button's height, that fits the region."""
    region = getattr(context, "region", None)
    if region is None or region.width <= 1:
        return most
    unit = 20.0 * context.preferences.system.ui_scale
    margins = 3.0  # tabs, the panel's own edges
    return min(most, max(4.0, region.width / unit - margins))


def _refresh() -> None:
    if _pictures is None:
        return
    _pictures.refresh()
    for window in bpy.context.window_manager.windows:
        _draw_again(window)


def _draw_again(window: Any) -> None:
    for area in window.screen.areas:
        if area.type == "VIEW_3D" and area.spaces.active.show_region_ui:
            for region in area.regions:
                if region.type == "UI" and region.active_panel_category == "TG4MM":
                    region.tag_redraw()


@bpy.app.handlers.persistent
def _on_frame(*_: Any) -> None:
    """In playback Blender draws the views alone: the sidebar with its time would stay as it was."""
    global _drawn_at
    if (now := time.monotonic()) < _drawn_at + _IN_PLAYBACK:
        return
    _drawn_at = now
    for window in bpy.context.window_manager.windows:
        if window.screen.is_animation_playing:
            _draw_again(window)


def register() -> None:
    global _pictures
    _pictures = Icons()
    bpy.app.handlers.frame_change_post.append(_on_frame)


def unregister() -> None:
    global _pictures
    bpy.app.handlers.frame_change_post.remove(_on_frame)
    if bpy.app.timers.is_registered(_refresh):
        bpy.app.timers.unregister(_refresh)
    if _pictures is not None:
        _pictures.close()
    _pictures = None
