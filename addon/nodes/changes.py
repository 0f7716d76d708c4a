"""Settings that the extension changes in a scene, its objects and the views, with the values from before."""

import math
from typing import Any

import bpy

BEFORE = "tg4mm_before"  # custom property of a scene, object or screen: the values from before, by path
_SPACE = "spaces[0]."  # of an area of a screen, the one that is shown; what follows is named below
# What the panel calls each setting; "" where another line stands for it.
_LABELS = {
    "render.fps": "Frame rate",
    "render.fps_base": "",
    "frame_start": "First frame",
    "frame_end": "Last frame",
    "view_settings.view_transform": "View transform",
    "view_settings.look": "Look",
    "view_settings.exposure": "Exposure",
    "view_settings.gamma": "Gamma",
    "cycles.transparent_max_bounces": "Cycles bounces",
    "cycles.min_transparent_bounces": "",
    "cycles.samples": "Cycles samples",
    "eevee.taa_samples": "EEVEE view samples",
    "eevee.taa_render_samples": "EEVEE samples",
    "display.render_aa": "Workbench samples",
    "display.shading.light": "Workbench light",
    "shading.type": "Viewport shading",
    "location": "Moved",
    "data.clip_start": "",
    "data.clip_end": "",
}


def put(holder: Any, wanted: dict[str, Any]) -> int:
    """Set values of a scene, an object or a screen by path; return how many changed. Those absent are left out."""
    before, changed = dict(holder.get(BEFORE, {})), 0
    for path, value in wanted.items():
        was = get(holder, path)
        if was is None or was == value:
            continue
        before.setdefault(path, was)
        owner, _, last = path.rpartition(".")
        setattr(holder.path_resolve(owner) if owner else holder, last, value)
        changed += 1
    if before:
        holder[BEFORE] = before
    return changed


def get(holder: Any, path: str) -> Any:
    """Return a value by path, a vector as a list; None if there is none."""
    try:
        value = holder.path_resolve(path)
    except ValueError:
        return None
    return list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def listed(scene: Any) -> list[str]:
    """Return a line for each setting that is not as before: "Frame rate: 24 → 30"."""
    lines: dict[str, None] = {}
    for holder in _holders(scene):
        before = dict(holder[BEFORE])
        for path, was in before.items():
            now = get(holder, path)
            if path == "render.fps":
                base = get(holder, "render.fps_base")
                was, now = was / before.get("render.fps_base", base), now / base
            if (label := _LABELS.get(path.rpartition(_SPACE)[2])) and not _same(was, now):
                what = holder.name if holder.id_type == "OBJECT" else f"{_text(was)} → {_text(now)}"
                lines[f"{label}: {what}"] = None
    return list(lines)


def restore(scene: Any) -> int:
    """Give the scene, its objects and the views the values from before; return how many settings changed."""
    changed = 0
    for holder in _holders(scene):
        before = {
            path: value if isinstance(value, str | int | float) else list(value)
            for path, value in holder[BEFORE].items()
        }
        changed += put(holder, before)
        del holder[BEFORE]
    return changed


def _holders(scene: Any) -> list[Any]:
    return [holder for holder in (scene, *scene.objects, *bpy.data.screens) if holder.get(BEFORE)]


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, int | float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=1e-6)
    return bool(list(a) == list(b))


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
