"""What the tests of the extension share: reading evaluated splats back out of Blender, and small scenes."""

from types import SimpleNamespace

import bpy
import numpy as np

BLOCKS = ("objects", "meshes", "materials", "node_groups", "collections")


def blocks():
    """Names of everything an import makes."""
    return {kind: {block.name for block in getattr(bpy.data, kind)} for kind in BLOCKS}


def import_splat(path, **options):
    """Import and return the object."""
    assert bpy.ops.import_scene.tg4mm_splat(filepath=str(path), **options) == {"FINISHED"}
    return bpy.context.object


def import_files(paths, **options):
    """Import several files as the file browser and a drop do; returns the active object."""
    files = [{"name": path.name} for path in paths]
    done = bpy.ops.import_scene.tg4mm_splat(directory=str(paths[0].parent), files=files, **options)
    assert done == {"FINISHED"}
    return bpy.context.object


def setter(extension, obj):
    """set(NAME, value) for the inputs of the object's modifier."""
    modifier = extension.nodes.scene.splat_modifier(obj)
    return lambda name, value: extension.compat.set_input(modifier, name, value)


def drawn_whole(extension, obj):
    """The object's modifier, set to draw every Gaussian at 1 σ, in real time."""
    put = setter(extension, obj)
    names = extension.names
    if extension.nodes.scene.moves(obj):
        put(names.SPEED, 1.0)
    least = ((names.MIN_OPACITY, 0.0), (names.MIN_SPLAT_OPACITY, 0.0))
    for name, value in (*least, (names.SIZE, 1.0), (names.RADIUS, 1.0)):
        put(name, value)
    return extension.nodes.scene.splat_modifier(obj)


def evaluated(obj, frame):
    """The geometry set at a frame, fractions allowed. It owns what is read from it: keep it as long."""
    bpy.context.scene.frame_set(int(np.floor(frame)), subframe=float(frame % 1))
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()


def read(cloud, name, field, width):
    """[N, width] float64 of an attribute."""
    data = cloud.attributes[name].data
    flat = np.empty(len(data) * width, dtype=np.float32)
    data.foreach_get(field, flat)
    return flat.reshape(-1, width).astype(np.float64)


def transforms(obj, frame):
    """[N, 4, 4] of the object's evaluated instances."""
    geometry = evaluated(obj, frame)
    flat = read(geometry.instances_pointcloud(), "instance_transform", "value", 16)
    return flat.reshape(-1, 4, 4).transpose(0, 2, 1)


def places(obj, frame):
    """[N, 3] of the instances' origins."""
    return transforms(obj, frame)[:, :3, 3]


def shown_colours(obj, frame=1):
    """[N, 3] linear RGB of the instances."""
    geometry = evaluated(obj, frame)
    return read(geometry.instances_pointcloud(), "colour", "color", 4)[:, :3]


def matrices(quats):
    """[N, 3, 3] rotations of unit quaternions wxyz [N, 4]."""
    import mathutils

    return np.array([mathutils.Quaternion(q).to_matrix() for q in quats])


def add_camera(place, size, ortho_scale=None):
    """The scene's camera at `place`, looking at the origin, for pictures of `size` pixels."""
    import mathutils

    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = place
    if place[:2] != (0, 0):  # from straight above a camera that is not turned has y up
        camera.rotation_euler = (-mathutils.Vector(place)).to_track_quat("-Z", "Y").to_euler()
    if ortho_scale is not None:
        camera.data.type, camera.data.ortho_scale = "ORTHO", ortho_scale
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    return camera


def render_cycles(path, samples, clear=False):
    """Render the scene to a PNG in Cycles with the extension's colour management; `clear`: no background."""
    scene = bpy.context.scene
    scene.render.engine, scene.render.film_transparent = "CYCLES", clear
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.seed = samples, False, 1
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.dither_intensity = 0.0
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


class Layout:
    """Stands in for Blender's layout: records what is drawn, and reads every property, as drawing does."""

    def __init__(self):
        self.drawn: list[str] = []  # labels; operators and properties, each with the text beside
        self.pictures = 0
        self.asked: list[tuple[str, SimpleNamespace]] = []  # operators and the properties they are given

    def label(self, text="", icon="NONE"):
        assert icon in bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items
        self.drawn.append(text)

    def operator(self, name, text="", **_):
        module, _, function = name.partition(".")
        assert getattr(getattr(bpy.ops, module), function).get_rna_type()
        self.drawn += [name, text]
        self.asked.append((name, SimpleNamespace()))
        return self.asked[-1][1]

    def prop(self, owner, path, text="", **_):
        owner.path_resolve(path) if hasattr(owner, "path_resolve") else getattr(owner, path)
        self.drawn += [path, text]

    def prop_search(self, owner, path, data, found, **_):
        getattr(data, found)
        self.prop(owner, path)

    def progress(self, factor, text):
        assert 0 <= factor <= 1
        self.drawn.append(f"progress {text}")

    def template_icon(self, icon_value, scale):
        assert scale > 1
        self.pictures += 1

    def column(self, **_):
        return self

    row = box = grid_flow = split = column
