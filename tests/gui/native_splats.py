"""Takes a picture of Blender's own splats (5.3 on), magnified, and says what they are.

    blender --background --python tests/gui/native_splats.py -- SPLAT.ply PICTURE.png

The extension must be installed. Prints, for two frames, the type of the evaluated point cloud and how far its points
are from the file's formula, then renders with Cycles. Python with pip's Blender runs it too.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np

SIZE = 256  # pixels


def main() -> None:
    splat_path, picture = sys.argv[sys.argv.index("--") + 1 :]
    import bl_ext.user_default.tg4mm as extension
    from bl_ext.user_default.tg4mm.core.splatfile import positions_at

    if not extension.compat.native_splats():
        sys.exit(f"Blender {bpy.app.version_string} has no splats of its own")
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.import_scene.tg4mm_splat(filepath=splat_path)
    obj, names, scene = bpy.context.object, extension.names, bpy.context.scene
    modifier = extension.nodes.scene.splat_modifier(obj)
    extension.compat.set_input(modifier, names.DRAW, names.NATIVE)
    if extension.compat.has_input(modifier, names.ALPHA):
        extension.compat.set_input(modifier, names.ALPHA, 20.0)
    extension.nodes.blending.true_colours(scene)
    read = extension.io.loading.read_splat(splat_path)
    for frame in (1, 8):
        scene.frame_set(frame)
        geometry = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
        cloud = geometry.pointcloud
        places = np.empty(3 * len(cloud.points), np.float32)
        cloud.attributes["position"].data.foreach_get("vector", places)
        places = places.reshape(-1, 3)[: len(read)]  # what comes after them are references
        off = np.abs(places - positions_at(read, frame - 1, 20.0)).max()
        print(f"frame {frame}: type {cloud.type}, farthest from the formula {off:.2g} scene units")
    low, high = extension.panels.showing.box([obj])
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = (middle + [0, -3 * radius, 0]).tolist()
    camera.rotation_euler = (np.pi / 2, 0, 0)
    scene.collection.objects.link(camera)
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.render.film_transparent = extension.nodes.blending.SAMPLES, True
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.filepath = picture
    bpy.ops.render.render(write_still=True)
    rgba = bpy.data.images.load(picture)
    pixels = np.empty(4 * SIZE * SIZE, np.float32)
    rgba.pixels.foreach_get(pixels)
    print(f"{picture}: {(pixels[3::4] > 0.5).mean():.0%} of it covered")


main()
