"""The panel Crop and Export and its operators: boxes, selection, floaters, export, mesh."""

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty

from ..nodes import drawing, points, scene
from ..reporting import reports
from . import cropping
from .panel import _SplatTab


class _Removes(bpy.types.Operator):
    """An operator that removes Gaussians of the active splat object"""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.splat_object(context) is not None

    @reports()
    def execute(self, context: Any) -> set[str]:
        obj, edited = scene.splat_object(context), context.mode == "EDIT_MESH"
        if context.mode != "OBJECT":  # what is edited is written to the mesh when Edit Mode is left
            bpy.ops.object.mode_set(mode="OBJECT")
        try:
            context.view_layer.update()
            gone, left = cropping.remove(obj, self.choice(context, obj))
        finally:
            if edited:
                bpy.ops.object.mode_set(mode="EDIT")
        self.report({"INFO"}, f"{gone:,} Gaussians removed, {left:,} remain")
        return {"FINISHED"}

    def choice(self, context: Any, obj: Any) -> cropping.Choice:
        """Return the mask of Gaussians to remove. Raises Tg4mmError."""
        raise NotImplementedError


class TG4MM_OT_crop(_Removes):
    """Crop by rest position: removed Gaussians stay removed at every magnification and time"""

    bl_idname = "tg4mm.crop"
    bl_label = "Crop"

    by: EnumProperty(  # type: ignore[valid-type]
        name="By",
        items=[
            ("BOX", "Box", "The boxes of the selected objects, else the crop box"),
            ("SELECTION", "Selection", "The points selected in Edit Mode"),
        ],
    )
    keep: BoolProperty(  # type: ignore[valid-type]
        name="Keep", description="Keep what is inside or selected; else remove it", default=True
    )

    @classmethod
    def description(cls, context: Any, properties: Any) -> str:
        what = {
            "BOX": "inside the selected objects' boxes, else the crop box",
            "SELECTION": "selected in Edit Mode",
        }
        return f"{'Keep only' if properties.keep else 'Remove'} what is {what[properties.by]}. {cls.__doc__}"

    def choice(self, context: Any, obj: Any) -> cropping.Choice:
        if self.by == "SELECTION":
            return cropping.not_selected(obj, selected=not self.keep)
        boxes = cropping.boxes_of(obj, context.selected_objects)
        return cropping.outside(obj, boxes, inside=not self.keep)


class TG4MM_OT_remove_floaters(_Removes):
    """Remove Gaussians that are faint, oversized, or far from the rest; the limit is in the settings"""

    bl_idname = "tg4mm.remove_floaters"
    bl_label = "Remove Floaters"

    by: EnumProperty(  # type: ignore[valid-type]
        name="By",
        items=[
            ("OPACITY", "Opacity", "Less opaque than the limit"),
            ("SIZE", "Size", "Larger than this multiple of the median Gaussian, by the longest axis"),
            ("DISTANCE", "Distance", "Farther from the centre than this multiple of the framed radius"),
        ],
    )
    opacity: FloatProperty(name="Opacity Below", default=0.05, min=0.0, max=1.0)  # type: ignore[valid-type]
    size: FloatProperty(name="Median Sizes", default=10.0, min=1.0)  # type: ignore[valid-type]
    distance: FloatProperty(name="Radii", default=3.0, min=1.0)  # type: ignore[valid-type]

    def draw(self, context: Any) -> None:
        self.layout.use_property_split = True
        self.layout.prop(self, "by")
        self.layout.prop(self, self.by.lower())

    def choice(self, context: Any, obj: Any) -> cropping.Choice:
        if self.by == "OPACITY":
            return cropping.faint(self.opacity)
        return cropping.large(self.size) if self.by == "SIZE" else cropping.far(obj, self.distance)


class TG4MM_OT_crop_outliers(_Removes):
    """Remove Gaussians so distant that all other positions lose precision in EEVEE and Workbench"""

    bl_idname = "tg4mm.crop_outliers"
    bl_label = "Crop Far Outliers"

    def choice(self, context: Any, obj: Any) -> cropping.Choice:
        return drawing.outliers


class TG4MM_OT_add_crop_box(bpy.types.Operator):
    """Add a box around the splats; move, rotate and scale it over the region to keep or remove"""

    bl_idname = "tg4mm.add_crop_box"
    bl_label = "Add Crop Box"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.splat_object(context) is not None and context.mode == "OBJECT"

    def execute(self, context: Any) -> set[str]:
        context.view_layer.update()
        box = cropping.add_box(scene.splat_object(context), points.receiving(context))
        for other in context.selected_objects:
            other.select_set(False)
        box.select_set(True)
        context.view_layer.objects.active = box
        return {"FINISHED"}


class TG4MM_OT_make_mesh(bpy.types.Operator):
    """Convert the shapes drawn in this frame to a separate mesh object, for other programs"""

    bl_idname = "tg4mm.make_mesh"
    bl_label = "Make Mesh"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.splat_object(context) is not None and context.mode == "OBJECT"

    def execute(self, context: Any) -> set[str]:
        try:
            made = cropping.make(scene.splat_object(context), points.receiving(context), context)
        except MemoryError:
            self.report({"ERROR"}, "Not enough memory for the mesh: crop, or draw as arrows")
            return {"CANCELLED"}
        self.report({"INFO"}, f"{made.name}: {len(made.data.polygons):,} faces")
        return {"FINISHED"}


class VIEW3D_PT_tg4mm_crop(_SplatTab, bpy.types.Panel):
    """Crop and export the active splat object"""

    bl_label = "Crop and Export"
    bl_idname = "VIEW3D_PT_tg4mm_crop"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        layout, obj = self.layout, scene.splat_object(context)
        if scene.sequence_frames(obj) is None and obj.mode == "OBJECT":  # else the mesh is an old one
            layout.label(text=f"{points.gaussians(obj.data).sum():,} Gaussians", icon="POINTCLOUD_DATA")
        column = layout.column(align=True)
        for by, text in (("BOX", "Box"), ("SELECTION", "Selected")):
            row = column.row(align=True)
            for keep, verb in ((True, "Keep"), (False, "Remove")):
                button = row.operator("tg4mm.crop", text=f"{verb} {text}")
                button.by, button.keep = by, keep
            if by == "BOX":
                row.operator("tg4mm.add_crop_box", text="", icon="ADD")
        layout.label(text="Floaters")
        row = layout.row(align=True)
        for by, text in (("OPACITY", "Faint"), ("SIZE", "Large"), ("DISTANCE", "Far")):
            row.operator("tg4mm.remove_floaters", text=text).by = by
        row = layout.row(align=True)
        row.operator("export_scene.tg4mm_splat", text="Export", icon="EXPORT")
        row.operator("tg4mm.make_mesh", icon="MESH_DATA")


_CLASSES = (
    TG4MM_OT_crop, TG4MM_OT_remove_floaters, TG4MM_OT_crop_outliers, TG4MM_OT_add_crop_box,
    TG4MM_OT_make_mesh, VIEW3D_PT_tg4mm_crop,
)  # fmt: skip


register, unregister = bpy.utils.register_classes_factory(_CLASSES)
