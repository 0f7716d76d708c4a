"""Settings that the extension changes in a scene and its objects, each with the value from before, to be restored."""

import math
from typing import Any

BEFORE = "tg4mm_before"  # custom property of a scene or an object: the values from before, by path
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
    "hide_render": "Hidden",
    "location": "Moved",
    "data.clip_start": "",
    "data.clip_end": "",
}


def put(holder: Any, wanted: dict[str, Any]) -> int:
    """Set a scene's or an object's values by path; return how many changed. Those it does not have are left out."""
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
    lines = []
    for holder in _holders(scene):
        before = dict(holder[BEFORE])
        for path, was in before.items():
            now = get(holder, path)
            if path == "render.fps":
                base = get(holder, "render.fps_base")
                was, now = was / before.get("render.fps_base", base), now / base
            if (label := _LABELS.get(path)) and not _same(was, now):
                lines.append(
                    f"{label}: {_text(was)} → {_text(now)}" if holder == scene else f"{label}: {holder.name}"
                )
    return lines


def restore(scene: Any) -> int:
    """Give the scene and its objects the values from before; return how many settings changed."""
    changed = 0
    for holder in _holders(scene):
        before = {
            path: value if isinstance(value, str | int | float) else list(value)
            for path, value in holder[BEFORE].items()
        }
        changed += put(holder, before)
        if before.get("hide_render") is False:  # it was hidden in the view, too, which is no property
            holder.hide_set(False)
        del holder[BEFORE]
    return changed


def _holders(scene: Any) -> list[Any]:
    return [holder for holder in (scene, *scene.objects) if holder.get(BEFORE)]


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, int | float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=1e-6)
    return bool(list(a) == list(b))


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def hide(obj: Any) -> None:
    """Hide an object in the view and in renders."""
    put(obj, {"hide_render": True})
    obj.hide_set(True)
