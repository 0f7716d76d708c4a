"""The settings of the panels Generate and Train: properties of the scene, saved with it."""

from __future__ import annotations

from functools import partial
from typing import Any

import bpy
from bpy import props

from dataset_gen.cameras import KINDS as CAMERAS

from .kinds import KINDS

_RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"}
GENERATE, TRAIN = "tg4mm_generate", "tg4mm_train"  # properties of the scene


def _length(name: str, text: str, default: float, least: float = 0.0) -> Any:
    return props.FloatProperty(
        name=name, description=text, default=default, min=least, soft_max=100.0, unit="LENGTH", precision=4,
    )  # fmt: skip


def _vector(name: str, text: str, default: tuple[float, float, float], subtype: str, digits: int) -> Any:
    return props.FloatVectorProperty(
        name=name, description=text, default=default, size=3, subtype=subtype, precision=digits
    )


_place = partial(_vector, subtype="TRANSLATION", digits=4)
_heading = partial(_vector, subtype="XYZ", digits=3)


class TG4MM_moving_object(bpy.types.PropertyGroup):
    """An object that takes part in the motion"""

    object: props.PointerProperty(type=bpy.types.Object, name="Object")  # type: ignore[valid-type]


class TG4MM_generate(bpy.types.PropertyGroup):
    """The scene's vibration, cameras and pictures"""

    # fmt: off
    moving: props.CollectionProperty(type=TG4MM_moving_object)  # type: ignore[valid-type]
    source: props.EnumProperty(  # type: ignore[valid-type]
        name="Motion", description="Source of the motion description", default="PANEL",
        items=[("PANEL", "One Mode", "One mode, described here"),
               ("FILE", "File", "Any number of modes, in a file of your own (JSON, or YAML with the core)")])
    motion_file: props.StringProperty(  # type: ignore[valid-type]
        name="Description", description="A motion description: .json or .yaml", subtype="FILE_PATH",
        options=_RELATIVE)
    kind: props.EnumProperty(  # type: ignore[valid-type]
        name="Mode", description="How the objects move", default="bending",
        items=[(name, kind.label, kind.description) for name, kind in KINDS.items()])
    frequency: props.FloatProperty(  # type: ignore[valid-type]
        name="Frequency", description="Hz; below half of the Frame Rate", default=5.0, min=0.001, soft_max=100.0,
        precision=3, unit="FREQUENCY")
    amplitude_in: props.EnumProperty(  # type: ignore[valid-type]
        name="Amplitude In", default="SCENE",
        description="Unit of the amplitude, which is the largest displacement of any vertex",
        items=[("SCENE", "Units", "Scene units"),
               ("PIXELS", "Pixels", "Pixels in the first training camera")])
    amplitude: _length("Amplitude", "Largest displacement", 0.01, 1e-9)  # type: ignore[valid-type]
    amplitude_px: props.FloatProperty(  # type: ignore[valid-type]
        name="Amplitude", description="Largest displacement, pixels in the first training camera", default=0.3,
        min=1e-4, soft_max=20.0, precision=3)
    phase: props.FloatProperty(  # type: ignore[valid-type]
        name="Phase", description="0 is a sine: at rest in the first timestep", subtype="ANGLE")

    point: _place("Point", "World coordinates", (0, 0, 0))  # type: ignore[valid-type]
    tip: _place("Tip", "The free end, world coordinates", (0, 0, 1))  # type: ignore[valid-type]
    axis: _heading("Axis", "World axes, any length", (0, 0, 1))  # type: ignore[valid-type]
    direction: _heading("Direction", "World axes, any length", (1, 0, 0))  # type: ignore[valid-type]
    length: _length("Length",  # type: ignore[valid-type]
                    "Distance along the axis over which the twist grows; 0: uniform rotation", 0.0)
    order: props.IntProperty(  # type: ignore[valid-type]
        name="Order", description="1 is the beam's lowest mode", default=1, min=1, max=3)
    wavelength: _length("Wavelength", "Distance between crests", 1.0, 1e-6)  # type: ignore[valid-type]
    rayleigh: props.BoolProperty(  # type: ignore[valid-type]
        name="Rayleigh", description="The Rayleigh wave of an elastic solid: points move on ellipses")
    decay_length: _length("Decay Length",  # type: ignore[valid-type]
                          "Depth below the surface's z at which the amplitude falls to 1/e; 0: constant", 0.0)
    level: props.FloatProperty(  # type: ignore[valid-type]
        name="Height", description="World z", unit="LENGTH", precision=4)
    hold: props.EnumProperty(  # type: ignore[valid-type]
        name="Held", description="Support of the soft body",
        items=[("HEIGHT", "Below a Height", "Sways above a height"),
               ("POINT", "At a Point", "Sways more with the distance from a point")])
    reach: _length("Reach",  # type: ignore[valid-type]
                   "Distance from the support over which the displacement grows linearly", 1.0, 1e-6)
    random: props.BoolProperty(  # type: ignore[valid-type]
        name="Random Direction", description="Every object sways independently")
    radius: _length("Radius", "Radius of the rim", 1.0, 1e-6)  # type: ignore[valid-type]
    drum_nodes: props.IntVectorProperty(  # type: ignore[valid-type]
        name="Nodes", description="Nodal diameters, and nodal circles counting the rim", size=2, default=(0, 1),
        min=0, max=20)
    sides: props.FloatVectorProperty(  # type: ignore[valid-type]
        name="Sides", description="Their lengths", size=2, default=(1, 1), min=1e-6, unit="LENGTH")
    plate_nodes: props.IntVectorProperty(  # type: ignore[valid-type]
        name="Half Waves", description="Along each side", size=2, default=(1, 1), min=1, max=20)
    thickness: _length("Thickness",  # type: ignore[valid-type]
                       "Extent along the normal; 0: unlimited", 0.0)
    group: props.StringProperty(  # type: ignore[valid-type]
        name="Vertex Group", description="Its weights scale each vertex's displacement")

    fps: props.FloatProperty(  # type: ignore[valid-type]
        name="Frame Rate", description="Timesteps of the dataset per second, Hz", default=30.0, min=0.01,
        soft_max=1000.0, precision=2, unit="FREQUENCY")
    timesteps: props.IntProperty(  # type: ignore[valid-type]
        name="Timesteps", description="Number of frames of the dataset", default=30, min=1, max=1000)

    cameras: props.EnumProperty(  # type: ignore[valid-type]
        name="Cameras", description="Camera positions of the training pictures",
        items=[(name, kind.label, kind.about.capitalize()) for name, kind in CAMERAS.items()])
    views: props.IntProperty(  # type: ignore[valid-type]
        name="Views", description="Training cameras", default=30, min=1, max=1000)
    test_views: props.IntProperty(  # type: ignore[valid-type]
        name="Test Views", description="Cameras of the test pictures", default=5, min=0, max=1000)
    size: props.IntProperty(  # type: ignore[valid-type]
        name="Size", description="Edge of the square pictures, pixels", default=128, min=8, max=4096,
        subtype="PIXEL")
    samples: props.IntProperty(  # type: ignore[valid-type]
        name="Samples", description="Light paths per pixel", default=96, min=1, max=65536)
    device: props.EnumProperty(  # type: ignore[valid-type]
        name="Device", description="Where Cycles renders",
        items=[("cpu", "CPU", ""), ("gpu", "GPU", ""), ("auto", "GPU or CPU", "A GPU if available")])
    truth: props.EnumProperty(  # type: ignore[valid-type]
        name="Truth per Pixel", default="none",
        description="Depth, normal, position and displacement of every pixel; the core's Python writes it",
        items=[("none", "None", "The motion of the vertices alone"), ("test", "Test Views", ""),
               ("all", "All Views", "Large")])
    alphas: props.StringProperty(  # type: ignore[valid-type]
        name="Magnified", default="5,10,20,50,100",
        description="Magnification factors of the ground truth: test pictures whose motion is 1 + factor times as "
                    "large")
    seed: props.IntProperty(  # type: ignore[valid-type]
        name="Seed", description="Seed of the renderer and of random parts of the motion", min=0)
    processes: props.IntProperty(  # type: ignore[valid-type]
        name="Processes", description="Render processes at once; 0: one for each core", min=0, max=256)
    label: props.StringProperty(  # type: ignore[valid-type]
        name="Name", description="First part of the dataset folder's name: letters, digits, - and _; empty: the file's")
    out: props.StringProperty(  # type: ignore[valid-type]
        name="Output", description="Folder that receives the dataset's folder", subtype="DIR_PATH", options=_RELATIVE)
    then_train: props.BoolProperty(  # type: ignore[valid-type]
        name="Then Train", description="Train splats on the dataset when it is complete, and import them")
    in_blender: props.BoolProperty(  # type: ignore[valid-type]
        name="This Blender", description="Render with this Blender instead of the core's: your version, but no truth "
        "per pixel and no report")
    # fmt: on


class TG4MM_train(bpy.types.PropertyGroup):
    """From a dataset to splats"""

    # fmt: off
    dataset: props.StringProperty(  # type: ignore[valid-type]
        name="Dataset", description="A dataset's folder", subtype="DIR_PATH", options=_RELATIVE)
    run: props.StringProperty(  # type: ignore[valid-type]
        name="Run", description="Folder for the run; an unfinished run there is resumed",
        subtype="DIR_PATH", options=_RELATIVE)
    quick: props.BoolProperty(  # type: ignore[valid-type]
        name="Quick", default=True,
        description="From a video, a coarse first answer in minutes: fewer Gaussians and iterations")
    device: props.EnumProperty(  # type: ignore[valid-type]
        name="Device", description="Device on which the core computes",
        items=[("cpu", "CPU", ""), ("cuda", "CUDA", "An NVIDIA GPU, with gsplat installed")])
    settings: props.StringProperty(  # type: ignore[valid-type]
        name="Settings", description="Training settings that differ from the defaults, separated by spaces: "
        "space.iterations=3000 motion.gauss_newton=0")
    # fmt: on


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (TG4MM_moving_object, TG4MM_generate, TG4MM_train)
)


def register() -> None:
    _register_classes()
    setattr(bpy.types.Scene, GENERATE, props.PointerProperty(type=TG4MM_generate))
    setattr(bpy.types.Scene, TRAIN, props.PointerProperty(type=TG4MM_train))


def unregister() -> None:
    delattr(bpy.types.Scene, TRAIN)
    delattr(bpy.types.Scene, GENERATE)
    _unregister_classes()
