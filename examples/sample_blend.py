"""A scene of Blender with a splat file in it, magnified: it plays without the extension, too.

    python examples/sample_blend.py SPLAT.ply OUT.blend [ALPHA]

Needs pip's Blender (the extra generate) and a clone.
"""

import os
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import addon


def main(splat, out, alpha="20"):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon.register()
    bpy.ops.import_scene.tg4mm_splat(filepath=str(Path(splat).resolve()))
    modifier = addon.nodes.scene.splat_modifier(bpy.context.object)
    addon.compat.set_input(modifier, addon.names.ALPHA, float(alpha))
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(out).resolve()), compress=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
    sys.stdout.flush()
    os._exit(0)  # pip's Blender may hang where Python ends
