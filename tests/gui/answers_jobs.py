"""More answers of answering.py, inside Blender: renders, the probe, and what the panels Generate and Train do."""

import bpy
import numpy as np
from answering import FOLDER, answer, clear


@answer
def prepare_render(engine, size, frames, to):
    """A camera that sees the drum, and a small picture; `frames` first and last, `to` where they are written."""
    import mathutils

    scene = bpy.context.scene
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        scene.collection.objects.link(scene.camera)
        bpy.ops.ed.undo_push(message="camera")  # else undoing what comes next takes the camera away too
    place = mathutils.Vector((1.2, -3.6, 2.6))
    scene.camera.location, scene.camera.rotation_euler = place, (-place).to_track_quat("-Z", "Y").to_euler()
    scene.render.engine = engine
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.cycles.samples, scene.eevee.taa_render_samples = 4, 4
    scene.cycles.use_denoising = False
    scene.frame_start, scene.frame_end = frames
    scene.render.filepath = str(FOLDER / to)
    scene.render.image_settings.file_format = "PNG"


@answer
def save_rendered(file):
    """Write the picture that was rendered last; False where there is none."""
    result = bpy.data.images.get("Render Result")
    if result is None:
        return False
    try:
        result.save_render(str(FOLDER / file))
    except RuntimeError:  # rendered nothing yet
        return False
    return True


@answer
def probed():
    """What the probe read last of the splats: its label, and the phasors, re and im of x, y, z per mode."""
    obj = next(obj for obj in bpy.data.objects if "tg4mm_version" in obj)
    return {"label": obj.get("tg4mm_probe_label"), "phasors": list(obj.get("tg4mm_probe_phasors", ()))}


@answer
def cube(size):
    """A cube with a subdivided surface, selected, a lamp, and nothing else."""
    clear()
    bpy.ops.mesh.primitive_cube_add(size=size)
    cube = bpy.context.view_layer.objects.active
    cube.modifiers.new("finer", "SUBSURF").levels = 2
    lamp = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    bpy.context.scene.collection.objects.link(lamp)


@answer
def put_settings(of, **values):
    """Set properties of the scene's `tg4mm_generate` or `tg4mm_train`."""
    for name, value in values.items():
        setattr(getattr(bpy.context.scene, of), name, value)


@answer
def highest():
    """Largest z of the active object's evaluated vertices."""
    obj = bpy.context.view_layer.objects.active
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return float(flat[2::3].max())


@answer
def job(kind):
    """State, progress and message of the extension's background job."""
    import bl_ext.user_default.tg4mm.jobs.commands as background

    found = background.get(kind)
    if found is None:
        return None
    progress = found.progress
    return {"state": found.state.value, "message": found.message, "done": progress.done, "total": progress.total,
            "results": found.results}  # fmt: skip
