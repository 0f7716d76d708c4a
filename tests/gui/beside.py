"""The same file in Blender's own import, in KIRI's add-on and in the extension: pictures side by side, time of a frame.

    python -m tests.gui.beside SPLAT [--kiri ZIP] [--own PNG] [--out WEBP]     pictures and drawing times
    python -m tests.gui.beside --play [--kiri ZIP]                             evaluation times of 200,000 and 1,000,000
    .venv53/bin/python -m tests.gui.beside --render SPLAT PNG                  Blender 5.3's own import, in background

ZIP is KIRI's repository without its wheels, and without the `wheels` of its manifest: they are for Python 3.11, and
only cropping needs them. Times are processor time, all threads: software OpenGL draws, and they do not depend on what
else the machine does.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

VIEW = {"look_from": [0.55, -1.0, 0.55], "at": [0.0, 0.0, -0.05]}
SIZE, PICTURE = (1000, 760), (480, 440)  # of the window; of a picture, cut from the middle of its 3D view
FIELD = 72.0  # mm: the width of a 3D view's picture along its longer side, with a lens of 50 mm
FRAMES = 5
MESSAGE = slice(128, 144), slice(66, 280)  # where EEVEE says that it compiles shaders
KIRI_IMPORT, KIRI_UPDATE = "sna.dgs_render_create_proxy_from_mesh_d5b41", "sna.dgs_render_refresh_scene_c0b35"


def median(times):
    """The first is not counted: it compiles shaders and fills caches."""
    return statistics.median(times[1:])


def framed(blender, distance, before=None):
    """The middle of the 3D view, uint8 [H, W, 3], once it no longer changes and shows more than `before`, a screen."""
    blender.ask("view", distance=distance, **VIEW)
    box, still, last = blender.region("VIEW_3D"), 0, None
    left, top = box.left + (box.width - PICTURE[0]) // 2, box.top + (box.height - PICTURE[1]) // 2
    for _ in range(300):  # EEVEE compiles its shaders, and adds up samples
        time.sleep(2)
        screen = blender.now()
        now = screen[top : top + PICTURE[1], left : left + PICTURE[0]]
        shown = before is None or (
            share(screen, before) > 0.03 and not share(screen[MESSAGE], before[MESSAGE])
        )
        still = still + 1 if shown and last is not None and (now == last).all() else 0
        if still == 10:
            break
        last = now
    return now


def share(a, b):
    """Share of the pixels of two pictures that differ by more than a change of the background's shading."""
    return float((abs(a.astype(int) - b.astype(int)).max(axis=2) > 40).mean())


def imported(blender, file, own):
    """Import a file: as Blender itself does, else with the extension."""
    path = f"{blender.inside}/{file}"
    operator = "wm.ply_import" if own else "import_scene.tg4mm_splat"
    blender.value(f"str(bpy.ops.{operator}(filepath={path!r}))", 600)


def pictures(splat, kiri, distance):
    """(label, picture, drawing times, ms) of each way to show the file in the window."""
    from .session import Session

    found = []

    def take(blender, label, before):
        found.append((label, framed(blender, distance, before), blender.ask("drawing", 900, frames=FRAMES)))
        print(f"{label}: {median(found[-1][2]):.0f} ms a frame to draw", flush=True)

    if kiri:
        with Session.start(kiri, [splat], SIZE) as blender:
            blender.ask("clear")
            framed(blender, distance)
            before = blender.now()
            imported(blender, splat.name, own=True)
            blender.value(f"str(bpy.ops.{KIRI_IMPORT}())", 600)
            blender.value("[obj.hide_set(obj.type == 'MESH') for obj in bpy.data.objects]")
            take(blender, "KIRI 3DGS Render 4.1.5, in 5.2", before)
    with Session.start(built(), [splat], SIZE) as blender:
        blender.ask("clear")
        framed(blender, distance)
        before = blender.now()
        imported(blender, splat.name, own=True)
        blender.value("[obj.select_set(False) for obj in bpy.data.objects]")
        points = (framed(blender, distance, before), blender.ask("drawing", 900, frames=FRAMES))[1]
        print(f"Blender 5.2's import, points: {median(points):.0f} ms a frame to draw", flush=True)
        blender.ask("clear")
        imported(blender, splat.name, own=False)
        usual = blender.ask("inputs")["Draw As"]
        take(blender, "tg4mm in 5.2", before)
        blender.ask("draw_as", mode="Ellipsoids")
        framed(blender, distance, before)
        print(f"{usual}, then Ellipsoids: {median(blender.ask('drawing', 900, frames=FRAMES)):.0f} ms")
    return found


def built():
    """The extension's zip, as the present sources make it."""
    import subprocess

    root = Path(__file__).resolve().parents[2]
    subprocess.run([sys.executable, "addon/make_extension.py"], cwd=root, check=True, capture_output=True)
    return max((root / "dist").glob("tg4mm-*.zip"), key=lambda path: path.stat().st_mtime)


def composed(parts, out):
    """Write (label, picture) side by side, each under its label."""
    from PIL import Image, ImageDraw, ImageFont

    width, height = PICTURE
    sheet = Image.new("RGB", (len(parts) * (width + 8) - 8, height + 28), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=17)
    for i, (label, picture) in enumerate(parts):
        draw.text((i * (width + 8) + 4, 3), label, fill="black", font=font)
        sheet.paste(Image.fromarray(picture), (i * (width + 8), 28))
    sheet.save(out, quality=84, method=6)
    print(f"{out}: {out.stat().st_size / 1000:.0f} kB")


def print_evaluation(blender, count, what):
    """Print the median time of evaluating a frame."""
    print(f"{count}, {what}: {median(blender.ask('stepping', 900, frames=9)):.1f} ms", flush=True)


def play(kiri):
    """Print the evaluation times of large files, in the window, nothing drawn."""
    import tempfile

    from tg4mm.core.splatfile import write_splat

    from .conftest import drum
    from .session import Session

    with tempfile.TemporaryDirectory() as scratch:
        files = [Path(scratch) / f"{side * side}.ply" for side in (447, 1000)]
        for side, path in zip((447, 1000), files, strict=True):
            write_splat(path, drum(side, (5.0,)))
        with Session.start(built(), files, SIZE) as blender:
            blender.ask("put_away")
            for path in files:
                for mode in ("Points", "Ellipsoids", "Splats"):
                    blender.ask("clear")
                    imported(blender, path.name, own=False)
                    blender.ask("draw_as", mode=mode)
                    print_evaluation(blender, path.stem, mode)
                blender.ask("clear")
                imported(blender, path.name, own=True)
                print_evaluation(blender, path.stem, "static points")
                blender.ask("sway", frequency=5.0)
                print_evaluation(blender, path.stem, "shape key")
        if not kiri:
            return
        with Session.start(kiri, files[:1], SIZE) as blender:
            blender.ask("clear")
            imported(blender, files[0].name, own=True)
            blender.ask("sway", frequency=5.0)
            blender.value(f"str(bpy.ops.{KIRI_IMPORT}())", 600)
            took = blender.ask("calling", 900, operator=KIRI_UPDATE, frames=4)
            print(f"{files[0].stem}, KIRI's Update Scene: {median(took):.0f} ms")


def play_native():
    """Print the evaluation times of large files drawn as Blender 5.3's own splats, in this Python's bpy."""
    import tempfile

    import bpy

    import addon
    from tg4mm.core.splatfile import write_splat

    from .conftest import drum

    addon.register()
    for side in (447, 1000):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        with tempfile.TemporaryDirectory() as scratch:
            write_splat(path := Path(scratch) / "drum.ply", drum(side, (5.0,)))
            bpy.ops.import_scene.tg4mm_splat(filepath=str(path))
        took = []
        for frame in range(1, 11):
            start = time.process_time()
            bpy.context.scene.frame_set(frame)
            took.append(1e3 * (time.process_time() - start))
        modifier = addon.nodes.scene.splat_modifier(bpy.context.object)
        drawn = addon.compat.get_input(modifier, addon.names.DRAW)
        print(f"{side * side}, {drawn} in {bpy.app.version_string}: {median(took):.1f} ms", flush=True)


def render(splat, out, distance, view_width):
    """Blender's own import from the same view, drawn by EEVEE in this Python's bpy; prints its time."""
    import bpy
    import mathutils

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.ply_import(filepath=str(splat))
    scene, camera = bpy.context.scene, bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    turned = mathutils.Vector(VIEW["look_from"]).to_track_quat("Z", "Y").to_matrix().to_4x4()
    camera.matrix_world = turned @ mathutils.Matrix.Translation((0, 0, distance))
    width, height = PICTURE
    # A 3D view's picture of the window's full width, of which PICTURE is the middle.
    camera.data.lens, camera.data.sensor_width = 50.0, FIELD * width / view_width
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.05, 0.05, 0.05)
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(out)
    start = time.process_time()
    bpy.ops.render.render(write_still=True)
    print(
        f"Blender {bpy.app.version_string}, {scene.render.engine}: {1e3 * (time.process_time() - start):.0f} ms"
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--kiri", type=Path)
    parser.add_argument("--own", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images/blender_beside.webp"))
    parser.add_argument("--distance", type=float, default=4.0)
    parser.add_argument("--view-width", type=int, default=818, help="of the window's 3D view, pixels")
    parser.add_argument("--play", action="store_true")
    parser.add_argument("--play-native", action="store_true")
    parser.add_argument("--render", action="store_true")
    options = parser.parse_args()
    if options.play:
        play(options.kiri)
    elif options.play_native:
        play_native()
    elif options.render:
        render(*options.files, options.distance, options.view_width)
    else:
        found = pictures(options.files[0], options.kiri, options.distance)
        import numpy as np
        from PIL import Image

        own = (
            [("Blender 5.3's own import", np.asarray(Image.open(options.own).convert("RGB")))]
            if options.own
            else []
        )
        composed([*own, *((label, picture) for label, picture, _ in found)], options.out)


if __name__ == "__main__":
    main()
