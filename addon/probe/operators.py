"""Operators of the probe: measure a point or a region, add a sphere, write CSV."""

from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_atomic

from .. import preferences
from ..nodes import points, scene
from ..reporting import reports
from . import picking, probe

MOST_ROWS = 5_000_000  # of a series: some 300 MB
_ABOUT = {
    "SELECTION": "Read the points selected in Edit Mode; of several the mean, weighted by opacity",
    "CURSOR": "Read the drawn Gaussian whose rest position is nearest to the 3D cursor",
    "SPHERE": "Read all Gaussians that rest inside the sphere empty; their mean, weighted by opacity",
}


class _OnMotion(bpy.types.Operator):
    """An operator on a splat object that moves"""

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.moves(scene.splat_object(context))


class TG4MM_OT_probe(_OnMotion):
    """Read amplitude, phase and direction of the motion that was measured (not magnified)"""

    bl_idname = "tg4mm.probe"
    bl_label = "Probe"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    source: EnumProperty(  # type: ignore[valid-type]
        name="Where",
        items=[
            ("SELECTION", "Selected Points", _ABOUT["SELECTION"]),
            ("CURSOR", "At 3D Cursor", _ABOUT["CURSOR"]),
            ("SPHERE", "In Sphere", _ABOUT["SPHERE"]),
        ],
    )

    @classmethod
    def description(cls, context: Any, properties: Any) -> str:
        return _ABOUT[properties.source]

    @reports()
    def execute(self, context: Any) -> set[str]:
        obj = scene.splat_object(context)
        if self.source == "SELECTION":
            found = picking.probe_selection(obj)
        elif self.source == "CURSOR":
            found = picking.probe_cursor(obj, context.scene.cursor.location)
        else:
            found = picking.probe_spheres(obj, picking.spheres_of(obj, context.selected_objects))
        picking.store(obj, found)
        self.report({"INFO"}, f"Probed: {found.label}")
        return {"FINISHED"}


class TG4MM_OT_add_probe_sphere(_OnMotion):
    """Add a sphere at the 3D cursor; move and scale it over the region that "In Sphere" is to read"""

    bl_idname = "tg4mm.add_probe_sphere"
    bl_label = "Add Probe Sphere"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        return super().poll(context) and context.mode == "OBJECT"

    def execute(self, context: Any) -> set[str]:
        obj = scene.splat_object(context)
        sphere = picking.add_sphere(obj, points.receiving(context), context.scene.cursor.location)
        for other in context.selected_objects:
            other.select_set(False)
        sphere.select_set(True)
        context.view_layer.objects.active = sphere
        return {"FINISHED"}


class TG4MM_OT_export_probe(_OnMotion, ExportHelper):
    """Write the probe's reading as a CSV file; its first lines name the units"""

    bl_idname = "tg4mm.export_probe"
    bl_label = "Export Probe as CSV"

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    filename_ext = ".csv"
    filter_glob: StringProperty(default="*.csv", options={"HIDDEN"})  # type: ignore[valid-type]
    content: EnumProperty(  # type: ignore[valid-type]
        name="Content",
        items=[
            (
                "SERIES",
                "Displacement Over Time",
                "Time (s) and displacement along x, y, z; a row for each time",
            ),
            (
                "PHASORS",
                "Phasor Table",
                "Frequency (Hz), amplitude, phase (°), direction; a row for each mode",
            ),
        ],
    )
    per_timestep: IntProperty(  # type: ignore[valid-type]
        name="Rows per Timestep",
        description="1: a row for each timestep of the recording; more: rows between them, from the modes",
        default=1,
        min=1,
        max=1000,
    )

    def invoke(self, context: Any, event: Any) -> set[str]:
        if picking.stored(scene.splat_object(context)) is None:
            return self.execute(context)  # which says so
        if not self.filepath:
            self.filepath = f"{_file_name(scene.splat_object(context).name)}_{self.content.lower()}.csv"
        return ExportHelper.invoke(self, context, event)

    def draw(self, context: Any) -> None:
        self.layout.use_property_split = True
        self.layout.prop(self, "content")
        if self.content == "SERIES":
            self.layout.prop(self, "per_timestep")

    @reports("written")
    def execute(self, context: Any) -> set[str]:
        obj = scene.splat_object(context)
        found = _reading(obj)
        unit = preferences.unit_for(context, obj)
        rows = (found.n_timesteps - 1) * self.per_timestep + 1
        if self.content == "SERIES" and rows > MOST_ROWS:
            count = f"{found.n_timesteps:,} timesteps make {rows:,} rows, more than {MOST_ROWS:,}"
            raise Tg4mmError(f"{count}: write the phasor table")
        if self.content == "SERIES":
            text = probe.series_csv(found, unit, obj.name, self.per_timestep)
        else:
            text = probe.phasor_csv(found, unit, obj.name)
        path = Path(bpy.path.abspath(self.filepath))
        _write(path, text)
        self.report({"INFO"}, f"Wrote {path}")
        return {"FINISHED"}


def _reading(obj: Any) -> probe.Probe:
    found = picking.stored(obj)
    if found is None:
        raise Tg4mmError("Nothing probed yet: use one of the buttons in the panel Probe first")
    return found


def _write(path: Path, text: str) -> None:
    """UTF-8, whole or not at all. Raises Tg4mmError or OSError, and leaves what was there."""
    if path.exists() and not path.is_file():
        raise Tg4mmError(f"{path}: cannot be written: not a regular file")
    try:
        write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8", newline="\n"))
    except OSError as error:
        error.filename = str(path)  # not the temporary one's
        raise


def _file_name(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_ ." else "_" for c in name).strip(". ") or "probe"


_CLASSES = (TG4MM_OT_probe, TG4MM_OT_add_probe_sphere, TG4MM_OT_export_probe)


register, unregister = bpy.utils.register_classes_factory(_CLASSES)
