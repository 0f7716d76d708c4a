"""The panels Generate and Train in the sidebar of the 3D view, tab TG4MM."""

from typing import Any

import bpy

from dataset_gen.cameras import KINDS

from .. import preferences
from ..declare import Declared
from . import commands, generating, kinds, objects
from .runner import Job, JobState

_NARROW = 280.0  # the sidebar as Blender opens it, pixels at a scale of 1
_BESIDE, _LETTER = 82.0, 6.4  # what stands beside a line of text; a letter, on average


_MOST_MESSAGES = 4  # lines of a program

_ui = Declared()
_GENERATE = "VIEW3D_PT_tg4mm_generate"


@_ui.panel(_GENERATE, "Generate", closed=True, order=10)
def draw_generate(layout: Any, context: Any) -> None:
    """A dataset of the open scene, vibrating"""
    settings = context.scene.tg4mm_generate
    _spread(layout)
    layout.prop(settings, "out")
    layout.prop(settings, "label", placeholder=generating.label(settings))
    if preferences.get(context).core_python:
        layout.column(heading="Render In").prop(settings, "in_blender")
        layout.prop(settings, "then_train")
    layout.label(text=f"Rest pose: frame {context.scene.frame_current}", icon="TIME")
    if _draw_job(layout, commands.GENERATE):
        return
    layout.operator("tg4mm.generate", icon="RENDER_ANIMATION")
    if generating.can_go_on(settings):
        layout.operator("tg4mm.generate", text="Resume", icon="FILE_REFRESH").go_on = True


@_ui.panel("VIEW3D_PT_tg4mm_mode", "Vibration", parent=_GENERATE)
def draw_vibration(layout: Any, context: Any) -> None:
    """Moving parts and their vibration"""
    settings = context.scene.tg4mm_generate
    _spread(layout)
    layout.prop(settings, "source", expand=True)
    if settings.source == "FILE":
        layout.prop(settings, "motion_file")
    else:
        _draw_objects(layout, settings)
        _draw_mode(layout, settings, context)
    layout.prop(settings, "fps")


def _draw_objects(layout: Any, settings: Any) -> None:
    moving = [item.object.name for item in settings.moving if item.object is not None]
    more = f" and {len(moving) - 3} more" if len(moving) > 3 else ""
    layout.label(text=f"Moves: {', '.join(moving[:3]) + more or 'everything'}", icon="OBJECT_DATA")
    row = layout.row(align=True)
    row.operator("tg4mm.use_selection", text="Selected")
    row.operator("tg4mm.move_everything", text="Everything")


def _draw_mode(layout: Any, settings: Any, context: Any) -> None:
    layout.prop(settings, "kind")
    for entry in kinds.rows(settings):
        row = layout.row(align=True)
        if entry.setting == "group" and context.object is not None and context.object.type == "MESH":
            row.prop_search(settings, "group", context.object, "vertex_groups", text=entry.text)
            continue
        row.prop(settings, entry.setting, text=entry.text)
        if entry.setting in (*objects.PLACES, *objects.HEADINGS, *objects.HEIGHTS):
            row.operator("tg4mm.mode_from_cursor", text="", icon="PIVOT_CURSOR").setting = entry.setting
    if settings.kind not in ("translate", "group"):
        layout.operator("tg4mm.fit_mode", icon="PIVOT_BOUNDBOX")
    layout.prop(settings, "frequency")
    row = layout.row(align=True)
    pixels = settings.amplitude_in == "PIXELS"
    row.prop(settings, "amplitude_px" if pixels else "amplitude")
    row.prop(settings, "amplitude_in", text="")
    layout.prop(settings, "phase")


@_ui.panel("VIEW3D_PT_tg4mm_views", "Cameras and Pictures", parent=_GENERATE, closed=True)
def draw_views(layout: Any, context: Any) -> None:
    """Cameras, pictures and truth of the dataset"""
    settings = context.scene.tg4mm_generate
    _spread(layout)
    layout.prop(settings, "timesteps")
    layout.prop(settings, "cameras")
    if not KINDS[settings.cameras].single:
        layout.prop(settings, "views")
    for name in ("test_views", "size", "samples", "device", "seed", "processes"):
        layout.prop(settings, name)
    if settings.test_views:
        layout.prop(settings, "alphas")
    if preferences.get(context).core_python and not settings.in_blender:
        layout.prop(settings, "truth")
    else:
        _draw_lines(layout, "Truth per pixel needs the core's Python", "INFO")


@_ui.panel("VIEW3D_PT_tg4mm_train", "Train", closed=True, order=11)
def draw_train(layout: Any, context: Any) -> None:
    """Splats of a dataset"""
    settings = context.scene.tg4mm_train
    _spread(layout)
    if not preferences.get(context).core_python:
        text = "Training needs tg4mm in a separate Python. Set that Python in the preferences."
        _draw_lines(layout, text, "INFO")
        layout.operator("preferences.addon_show", text="Preferences").module = preferences.PACKAGE
        return
    for name in ("dataset", "run", "device", "settings", "quick"):
        layout.prop(settings, name)
    if not _draw_job(layout, commands.TRAIN):
        layout.operator("tg4mm.train", icon="OUTLINER_OB_POINTCLOUD")
        layout.operator("import_scene.tg4mm_video", text="From Video", icon="FILE_MOVIE")


def _draw_job(layout: Any, kind: str) -> bool:
    job = commands.get(kind)
    if job is None:
        return False
    if not job.running:
        _draw_end(layout, job)
        return False
    column = layout.column(align=True)
    column.progress(factor=job.progress.factor, text=job.message or job.progress.text)
    row = column.row()
    row.enabled = not job.cancelling
    row.operator("tg4mm.cancel_job", icon="CANCEL").kind = kind
    for line in job.messages[:_MOST_MESSAGES]:
        _draw_lines(layout, " ".join(line.split()), "NONE")
    return True


def _draw_end(layout: Any, job: Job) -> None:
    icons = {JobState.DONE: "CHECKMARK", JobState.FAILED: "ERROR", JobState.CANCELLED: "CANCEL"}
    _draw_lines(layout, job.message, icons[job.state])
    for warning in list(job.warnings)[:3]:
        _draw_lines(layout, warning, "INFO")
    if len(job.warnings) > 3:
        layout.label(text=f"and {len(job.warnings) - 3} more warnings", icon="BLANK1")


def _spread(layout: Any) -> None:
    """Use split labels without decorators, because these settings cannot be animated."""
    layout.use_property_split, layout.use_property_decorate = True, False


def _draw_lines(layout: Any, text: str, icon: str) -> None:
    """Draw a message in lines that fit the sidebar, which truncates longer ones."""
    region, scale = bpy.context.region, bpy.context.preferences.system.ui_scale
    pixels = region.width / scale if region is not None and region.type == "UI" else _NARROW
    column = layout.column(align=True)
    column.scale_y = 0.8
    for i, line in enumerate(wrapped(text, max(int((pixels - _BESIDE) / _LETTER), 12))):
        column.label(text=line, icon=icon if i == 0 else "BLANK1")


def wrapped(text: str, width: int) -> list[str]:
    """Wrap text to lines of at most `width` characters, breaking paths at their separators where possible."""
    lines = [""]
    for word in text.replace("/", "/\u200b").replace("\\", "\\\u200b").split(" "):
        for i, piece in enumerate(word.split("\u200b")):
            gap = " " if i == 0 and lines[-1] else ""
            if lines[-1] and len(lines[-1] + gap + piece) > width:
                lines.append("")
                gap = ""
            lines[-1] += gap + piece
    return [line[i : i + width] for line in lines for i in range(0, max(len(line), 1), width)]


register, unregister = _ui.register, _ui.unregister
