"""Splat files as Blender objects: a point mesh, the node tree that plays it, and its materials."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tg4mm.core.splatfile import SplatFile

from .. import compat, names
from . import Content, build_player, changes, clock
from .blending import make_materials
from .clock import rms_amplitude
from .graph import Made
from .points import fill_mesh, fill_references, main_axis, values

NAME_LENGTH = 40  # of what a name may have, so that what is added to it still fits


def make_objects(splats: Sequence[SplatFile], labels: Sequence[str], collection: Any) -> list[Any]:
    """Create one object per splat file and link it to `collection`. If anything fails, nothing is left behind."""
    with Made() as made:
        objects = [
            _object(splat, label[:NAME_LENGTH], made) for splat, label in zip(splats, labels, strict=True)
        ]
        for obj in objects:
            collection.objects.link(obj)
    return objects


def _object(splat: SplatFile, name: str, made: Made) -> Any:
    mesh = made.keep(bpy.data.meshes.new(name))
    fill_mesh(mesh, splat)
    squares = np.zeros(len(splat))
    for amplitudes in amplitudes_of(mesh, splat.n_modes):
        squares += amplitudes.astype(np.float64) ** 2
    content = Content(
        count=len(splat),
        sh_degree=splat.sh_degree,
        freqs_hz=splat.freqs_hz.tolist(),
        fps=splat.fps,
        amplitude=float(np.sqrt(squares.max(initial=0.0))),
    )
    obj = _player(name, mesh, content, made)
    _describe(obj, splat)
    return obj


def make_sequence(
    paths: Sequence[Path],
    name: str,
    collection: Any,
    read: Callable[[Path], SplatFile],
) -> tuple[Any, int]:
    """Create an object that shows one file per timestep; return it and the largest Gaussian count.

    The frames are objects of a collection that is in no scene; files may differ in the number of Gaussians. If anything
    fails, nothing made here is left.
    """
    with Made() as made:
        base = _free_name(name[:NAME_LENGTH])
        frames = made.keep(bpy.data.collections.new(f"{base} frames"))
        most = degree = 0
        for i, path in enumerate(paths):
            splat = read(path)
            most, degree = max(most, len(splat)), max(degree, splat.sh_degree)
            mesh = made.keep(bpy.data.meshes.new(f"{base} {i:06d}"))
            fill_mesh(mesh, splat, references=False)
            frames.objects.link(made.keep(bpy.data.objects.new(mesh.name, mesh)))
        content = Content(count=most, sh_degree=degree, frames=frames, n_frames=len(paths))
        mesh = made.keep(bpy.data.meshes.new(base))
        fill_references(mesh)
        obj = _player(base, mesh, content, made)
        obj[names.MARK], obj[names.FPS], obj[names.FREQUENCIES] = 1, 0.0, []
        obj[names.TIMESTEPS], obj[names.FRAMES] = len(paths), frames.name
        collection.objects.link(obj)
    return obj, most


def splat_modifier(obj: Any) -> Any | None:
    """Return the modifier that moves the object's splats, or None for other objects."""
    if obj is None or names.MARK not in obj:
        return None
    return obj.modifiers.get(names.MODIFIER)


def splat_object(context: Any) -> Any:
    """Return the active splat object, or the one that owns the active probe sphere or crop box, else None."""
    obj = context.object
    if obj is None:
        return None
    target = obj if names.MARK in obj else obj.get(names.PROBE_OF) or obj.get(names.CROP_OF)
    modifier = splat_modifier(target)
    return None if modifier is None or modifier.node_group is None else target


def sequence_frames(obj: Any) -> list[Any] | None:
    """Return the frame objects of a sequence, or None if the object is not a sequence."""
    frames = bpy.data.collections.get(obj.get(names.FRAMES, ""))
    return None if frames is None else sorted(frames.objects, key=lambda frame: frame.name)


def first_mesh(obj: Any) -> Any:
    """Return the object's mesh, or the first frame's mesh for a sequence."""
    frames = sequence_frames(obj)
    return (obj if frames is None else frames[0]).data


def moves(obj: Any) -> bool:
    """Return whether the object is a splat object with modes of motion."""
    return splat_modifier(obj) is not None and len(obj[names.FREQUENCIES]) > 0


def set_timeline(scene: Any, new: Sequence[Any], fps: float, n_timesteps: int) -> list[str]:
    """Set the recorded frame rate, slow motion, and the frames of the whole recording; show the largest motion.

    A scene in which something but the `new` objects moves keeps its timeline, as another frame rate would retime its
    keys, and the new objects take the speed of the others. Returns messages.
    """
    if not fps and n_timesteps <= 1:
        return []
    others, moving = [obj for obj in scene.objects if obj not in new], [obj for obj in new if moves(obj)]
    if (before := next(filter(moves, others), None)) or any(map(_has_keys, bpy.data.actions)):
        slower = before and compat.get_number(splat_modifier(before), names.SPEED)
        for obj in moving:
            compat.set_input(
                splat_modifier(obj), names.SPEED, slower or 1 / clock.slow_motion(scene, strongest(obj))
            )
        return [f"Frame rate kept at {clock.rate(scene):g}: the scene is already animated"]
    if fps:
        most = int(scene.render.bl_rna.properties["fps"].hard_max)
        whole = min(max(1, math.ceil(fps)), most)
        changes.put(scene, {"render.fps": whole, "render.fps_base": whole / fps})
    times = max((clock.slow_motion(scene, strongest(obj)) for obj in moving), default=1)
    for obj in moving:
        compat.set_input(splat_modifier(obj), names.SPEED, 1 / times)
    wanted = max(1, times * n_timesteps)
    last = min(wanted, int(scene.bl_rna.properties["frame_end"].hard_max))
    changes.put(scene, {"frame_start": 1, "frame_end": last})
    notes = [f"Last frame {last:,}, as Blender has no later one"] if last < wanted else []
    if moving and (frame := most_displaced(moving[0], last, 1 / times)) > 1:
        scene.frame_set(frame)
    return notes


def strongest(obj: Any) -> float:
    """Return the frequency, Hz, of the mode with the largest rms amplitude."""
    return float(obj[names.FREQUENCIES][int(np.argmax(obj[names.MODE_RMS]))])


def most_displaced(obj: Any, last: int, speed: float = 1.0) -> int:
    """Return the frame, 1 … `last`, in which the strongest mode is displaced most, rms over the Gaussians.

    A sine is at rest in frame 1, where no magnification would show. Of frames alike, the first.
    """
    k = int(np.argmax(obj[names.MODE_RMS]))
    turns_per_frame = speed * float(obj[names.FREQUENCIES][k]) / float(obj[names.FPS])
    if turns_per_frame <= 0:
        return 1
    part = names.phasor(k)
    re, im = (values(obj.data, part[name]).ravel() for name in ("re", "im"))
    angle = 2 * np.pi * turns_per_frame * np.arange(min(last, math.ceil(0.5 / turns_per_frame) + 1))
    c, s = np.cos(angle), np.sin(angle)
    power = c**2 * float(re @ re) + s**2 * float(im @ im) - 2 * c * s * float(re @ im)
    return 1 + int(np.argmax(power >= (1 - 1e-6) * power.max()))


def _has_keys(action: Any) -> bool:
    first, last = action.frame_range
    return bool(last > first)


def _player(name: str, mesh: Any, content: Content, made: Made) -> Any:
    materials = make_materials(name, made)
    for material in materials:
        mesh.materials.append(material)
    tree = build_player(name, content, materials, made)
    obj = made.keep(bpy.data.objects.new(name, mesh))
    obj.modifiers.new(names.MODIFIER, "NODES").node_group = tree
    return obj


def _describe(obj: Any, splat: SplatFile) -> None:
    obj[names.MARK], obj[names.FPS], obj[names.FREQUENCIES] = 1, splat.fps, splat.freqs_hz.tolist()
    # Whole numbers of a property have 32 bits.
    obj[names.TIMESTEPS] = splat.n_timesteps if splat.n_timesteps < 2**31 else float(splat.n_timesteps)
    measure_modes(obj)
    obj[names.MODE_AXES] = [float(x) for phasors in splat.displacement for x in main_axis(phasors)]
    if splat.time_origin_s:
        obj[names.TIME_ORIGIN] = splat.time_origin_s
    if splat.low_pass_px2 is not None:
        obj[names.LOW_PASS] = splat.low_pass_px2
    if splat.linear:
        obj[names.LINEAR] = True
    if splat.unit_scale_m is not None:
        obj[names.UNIT_SCALE] = splat.unit_scale_m


def amplitudes_of(mesh: Any, n_modes: int) -> Iterator[np.ndarray]:
    """Yield, mode by mode, the amplitude [N] of every Gaussian in file units."""
    return (values(mesh, names.amplitude(k)) for k in range(n_modes))


def measure_modes(obj: Any) -> None:
    """Compute the panel's figures of each mode: largest and rms amplitude over the remaining Gaussians."""
    amplitudes = list(amplitudes_of(obj.data, len(obj[names.FREQUENCIES])))
    opacities = values(obj.data, names.OPACITY)
    obj[names.MODE_AMPLITUDES] = [float(a.max()) for a in amplitudes]
    obj[names.MODE_RMS] = [rms_amplitude(a, opacities) for a in amplitudes]


def _free_name(name: str) -> str:
    """`name`, or with a number after it, such that no object's name starts with it: frames go by their names."""
    taken = [obj.name for obj in bpy.data.objects]
    free, number = name, 1
    while any(other.startswith(free) for other in taken):
        number += 1
        free = f"{name} {number}"
    return free
