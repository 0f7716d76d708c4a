"""Operators of the probe: measure a point or a region, add a sphere, write CSV."""

from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_atomic

from .. import preferences
from ..declare import Declared, on_motion, reports
from ..nodes import points, scene
from . import picking
from .probe import Probe, phasor_csv, series_csv

MOST_ROWS = 5_000_000  # of a series: some 300 MB
_ABOUT = {
    "SELECTION": "Read the points selected in Edit Mode; of several the mean, weighted by opacity",
    "CURSOR": "Read the Gaussian that is drawn nearest to the 3D cursor in this frame",
    "SPHERE": "Read all Gaussians that rest inside the sphere empty; their mean, weighted by opacity",
}


_ui = Declared()
_SOURCES = {"SELECTION": "Selected Points", "CURSOR": "At 3D Cursor", "SPHERE": "In Sphere"}
_ITEMS = [(name, label, _ABOUT[name]) for name, label in _SOURCES.items()]


@_ui.operator(
    "Probe", on_motion, about=lambda context, properties: _ABOUT[properties.source],
    source=EnumProperty(name="Where", items=_ITEMS),
)  # fmt: skip
def probe(operator: Any, context: Any) -> str:
    """Read amplitude, phase and direction of the motion that was measured (not magnified)"""
    obj = scene.splat_object(context)
    if operator.source == "SELECTION":
        found = picking.probe_selection(obj)
    elif operator.source == "CURSOR":
        found = picking.probe_cursor(context.scene, obj)
    else:
        found = picking.probe_spheres(obj, picking.spheres_of(obj, context.selected_objects))
    picking.store(obj, found)
    return f"Probed: {found.label}"


@_ui.operator("Add Probe Sphere", lambda context: on_motion(context) and context.mode == "OBJECT")
def add_probe_sphere(operator: Any, context: Any) -> None:
    """Add a sphere at the 3D cursor; move and scale it over the region that "In Sphere" is to read"""
    obj, place = scene.splat_object(context), context.scene.cursor.location
    points.choose_alone(context, picking.add_sphere(obj, points.receiving(context), place))


class TG4MM_OT_export_probe(bpy.types.Operator, ExportHelper):
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

    @classmethod
    def poll(cls, context: Any) -> bool:
        return on_motion(context)

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
            text = series_csv(found, unit, obj.name, self.per_timestep)
        else:
            text = phasor_csv(found, unit, obj.name)
        path = Path(bpy.path.abspath(self.filepath))
        _write(path, text)
        self.report({"INFO"}, f"Wrote {path}")
        return {"FINISHED"}


def _reading(obj: Any) -> Probe:
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


_ui.classes.append(TG4MM_OT_export_probe)
register, unregister = _ui.register, _ui.unregister
