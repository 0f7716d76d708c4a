"""The animated scene as a .blend that plays by itself: shape keys, drivers, and a slider for α.

Every real basis shape of the motion (vibration/motion.py) is a shape key, and its gain over time a driver of
plain arithmetic in the frame number. Blender evaluates such "simple expressions" itself: the file plays where
scripts may not run, and nothing of this package is needed. The custom property `alpha` of the empty "tg4mm"
magnifies what α magnifies. Frame t is timestep t.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from .build import DISPLACEMENT, Stage
from .cameras import SceneCamera
from .errors import GenerateError
from .tree import whole
from .vibration import DampedSinusoid, Motion, Ramp
from .vibration.motion import Basis

CONTROL = "tg4mm"  # the empty that carries alpha
_HEADROOM = 1000.0  # shape keys hold this many times the displacement: Blender keeps their values within ±10
_LIMIT = 10.0  # of a shape key's value
CamerasAt = Callable[[int], Mapping[str, Sequence[SceneCamera]]]


def save_animation(
    stage: Stage,
    motion: Motion,
    n_timesteps: int,
    path: Path,
    cameras: CamerasAt | None = None,
    size: int = 512,
) -> list[str]:
    """Turns the stage into an animation and saves it; the stage is of no use for rendering afterwards.

    Parameters: `n_timesteps`, T: the frames are 0 … T − 1 at the motion's frame rate; `cameras`, those of each
    split at a timestep: they become "train r_000" …, keyed where they move, and the first one looks; without,
    the stage's camera stays; `size`, of the picture, pixels. Returns the names of images that could not be
    packed (their files are missing). Raises GenerateError if the file cannot be written.
    """
    control = _control(stage.scene)
    peaks = np.abs(motion.basis_gains(np.arange(max(n_timesteps, 2)))).max(axis=1, initial=1.0)
    for obj, rest, basis in zip(stage.objects, stage.rest, motion.basis, strict=True):
        _shape_keys(obj, rest, basis, peaks * _HEADROOM)
        _drive(obj, motion, peaks * _HEADROOM, control)
    _clock(stage.scene, motion.fps, n_timesteps)
    _picture(stage.scene, size)
    if cameras is not None:
        _place(stage, [cameras(t) for t in range(n_timesteps)])
    unpacked = _pack_images()
    _save(path)
    return unpacked


def _control(scene: bpy.types.Scene) -> bpy.types.Object:
    control = bpy.data.objects.new(CONTROL, None)
    control.empty_display_size = 0.25
    control["alpha"] = 0.0
    text = "Motion is shown at 1 + alpha times its size"
    slider = control.id_properties_ui("alpha")
    slider.update(min=-1.0, soft_min=0.0, max=1000.0, soft_max=100.0, default=0.0, description=text)
    control.property_overridable_library_set('["alpha"]', True)
    scene.collection.objects.link(control)
    return control


def _key_name(number: int) -> str:
    return f"mode {number}"


def _shape_keys(obj: bpy.types.Object, rest: np.ndarray, basis: np.ndarray, scales: np.ndarray) -> None:
    """Add a shape key, rest + scale · shape, for each basis shape that moves this object."""
    mesh = obj.data
    if DISPLACEMENT in mesh.attributes:
        mesh.attributes.remove(mesh.attributes[DISPLACEMENT])
    mesh.vertices.foreach_set("co", rest.astype(np.float32).ravel())
    mesh.update()
    if not basis.any():
        return
    obj.shape_key_add(name="rest", from_mix=False)
    for number, (shape, scale) in enumerate(zip(basis, scales, strict=True)):
        if shape.any():
            key = obj.shape_key_add(name=_key_name(number), from_mix=False)
            key.data.foreach_set("co", (rest + scale * shape).astype(np.float32).ravel())
            key.slider_min, key.slider_max = -_LIMIT, _LIMIT


def _drive(obj: bpy.types.Object, motion: Motion, scales: np.ndarray, control: bpy.types.Object) -> None:
    keys = obj.data.shape_keys
    for number, (basis, scale) in enumerate(zip(motion.bases, scales, strict=True)):
        if keys is None or _key_name(number) not in keys.key_blocks:
            continue
        curve = keys.key_blocks[_key_name(number)].driver_add("value")
        _identity(curve)
        driver = curve.driver
        driver.type = "SCRIPTED"
        factor = f"/{float(scale)!r}"
        if motion.magnified[basis.mode]:
            variable = driver.variables.new()
            variable.name = "alpha"
            variable.targets[0].id = control
            variable.targets[0].data_path = '["alpha"]'
            factor = f"*(1+alpha){factor}"
        driver.expression = expression(motion, basis) + factor


def _identity(curve: bpy.types.FCurve) -> None:
    """Takes away the curve that a new driver's value goes through.

    From 5.0 on it is a Bézier from (0, 0) to (1, 1), which turns values between 0 and 1e-4 into 0.
    """
    while curve.keyframe_points:
        curve.keyframe_points.remove(curve.keyframe_points[0])
    while curve.modifiers:
        curve.modifiers.remove(curve.modifiers[0])


def expression(motion: Motion, basis: Basis) -> str:
    """The gain of a basis shape at α = 0 as arithmetic in `frame`."""
    law, fps = motion.laws[basis.mode], motion.fps
    if isinstance(law, DampedSinusoid):
        wave = "sin" if basis.quadrature else "cos"
        turn = math.atan2(basis.turn.imag, basis.turn.real)
        text = f"{wave}({float(2.0 * math.pi * law.frequency_hz / fps)!r}*frame+({turn!r}))"
        return text if law.decay_s is None else f"{text}*exp(-frame/{fps * law.decay_s!r})"
    if isinstance(law, Ramp):
        slope = (1j * basis.turn / fps).imag if basis.quadrature else (1j * basis.turn / fps).real
        return f"({float(slope)!r})*frame"
    raise TypeError(f"no expression for the time law {law!r}")


def _clock(scene: bpy.types.Scene, fps: float, n_timesteps: int) -> None:
    """Frames 0 … T − 1; Blender's rate is a whole number over a base."""
    whole = min(max(round(fps), 1), 32767)
    scene.render.fps, scene.render.fps_base = whole, whole / fps
    scene.frame_start, scene.frame_end = 0, n_timesteps - 1
    scene.frame_set(0)


def _picture(scene: bpy.types.Scene, size: int) -> None:
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = True
    scene.view_settings.view_transform = "Standard"


def _place(stage: Stage, cameras: Sequence[Mapping[str, Sequence[SceneCamera]]]) -> None:
    tracks: dict[str, dict[int, SceneCamera]] = {}
    for t, splits in enumerate(cameras):
        for split, views in splits.items():
            for camera in views:
                tracks.setdefault(f"{split} {camera.name}", {})[t] = camera
    collection = bpy.data.collections.new("cameras")
    stage.scene.collection.children.link(collection)
    placed = [_camera(name, track, collection) for name, track in tracks.items()]
    if placed:
        stage.scene.camera = placed[0]
        bpy.data.objects.remove(stage.camera)


def _camera(
    name: str, track: Mapping[int, SceneCamera], collection: bpy.types.Collection
) -> bpy.types.Object:
    obj = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    obj.rotation_mode = "QUATERNION"
    obj.data.sensor_fit = "HORIZONTAL"
    obj.data.lens_unit = "FOV"
    obj.data.clip_start, obj.data.clip_end = 0.01, 100.0
    collection.objects.link(obj)
    moves = len(set(track.values())) > 1
    turn = None
    for t, camera in track.items() if moves else list(track.items())[:1]:
        pose = Matrix(camera.camera_to_world.tolist())
        quaternion = pose.to_quaternion()
        if turn is not None:
            quaternion.make_compatible(turn)
        obj.location, obj.rotation_quaternion = pose.to_translation(), quaternion
        obj.data.angle = camera.angle_x
        obj.data.shift_x, obj.data.shift_y = -camera.shift[0], camera.shift[1]
        turn = quaternion
        if moves:
            _key(obj, ("location", "rotation_quaternion"), t)
            _key(obj.data, ("lens", "shift_x", "shift_y"), t)
    return obj


def _key(data: Any, names: Sequence[str], frame: int) -> None:
    for name in names:
        data.keyframe_insert(name, frame=frame)


def _pack_images() -> list[str]:
    missing = []
    for image in bpy.data.images:
        if image.source in ("FILE", "GENERATED", "TILED") and image.users and not image.packed_files:
            try:
                image.pack()
            except RuntimeError:
                missing.append(image.name)
    return missing


def _save(path: Path) -> None:
    try:
        with whole(path) as temporary:
            bpy.ops.wm.save_as_mainfile(
                filepath=str(temporary), compress=True, copy=True, check_existing=False
            )
    except (OSError, RuntimeError) as error:
        raise GenerateError(f"{path} cannot be written: {' '.join(str(error).split())}") from None
