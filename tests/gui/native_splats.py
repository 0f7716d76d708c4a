"""Tries the draw mode Native in a Blender that has splats of its own (5.3 on), and says what it found.

    blender --background --python tests/gui/native_splats.py -- SPLAT.ply PICTURE.png

The extension must be installed. Prints, for two frames, the type of the evaluated point cloud, its attributes and
how far its points are from the file's formula, then renders a picture. Never run: no such Blender was to be had.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np


def main() -> None:
    splat_path, picture = sys.argv[sys.argv.index("--") + 1 :]
    import bl_ext.user_default.tg4mm as extension

    if not extension.compat.native_splats():
        sys.exit(f"Blender {bpy.app.version_string} has no splats of its own")
    bpy.ops.import_scene.tg4mm_splat(filepath=splat_path)
    obj, names, scene = bpy.context.object, extension.names, bpy.context.scene
    modifier = extension.nodes.scene.splat_modifier(obj)
    extension.compat.set_input(modifier, names.DRAW, names.NATIVE)
    if extension.compat.has_input(modifier, names.ALPHA):
        extension.compat.set_input(modifier, names.ALPHA, 20.0)
    read = extension.io.loading.read_splat(splat_path)
    from bl_ext.user_default.tg4mm.core.splatfile import positions_at

    for frame in (1, 8):
        scene.frame_set(frame)
        geometry = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
        cloud = geometry.pointcloud
        places = np.empty(3 * len(cloud.points), np.float32)
        cloud.attributes["position"].data.foreach_get("vector", places)
        off = np.abs(places.reshape(-1, 3) - positions_at(read, frame - 1, 20.0)).max()
        print(
            f"frame {frame}: type {getattr(cloud, 'type', '?')}, farthest from the formula {off:.2g} scene units"
        )
        print(
            "  ",
            ", ".join(f"{a.name} {a.data_type}" for a in cloud.attributes if not a.name.startswith("mode_")),
        )
    scene.render.filepath = picture
    if scene.camera is None:
        low, high = extension.panels.showing.box([obj])
        middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        camera.location = (middle + [0, -3 * radius, 0]).tolist()
        camera.rotation_euler = (np.pi / 2, 0, 0)
        scene.collection.objects.link(camera)
        scene.camera = camera
    bpy.ops.render.render(write_still=True)
    print(picture)


main()
