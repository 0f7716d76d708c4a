"""Prepare a render job from settings: geometry, motion, list of pictures; claims the output folder."""

import hashlib
import importlib.metadata
import importlib.util
import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from tg4mm.core import __version__
from tg4mm.core.progress import say

from . import processes, tree, truth
from .cameras import cameras_at
from .cameras.paths import moving_points
from .effects import codec
from .errors import GenerateError, blender_remedy
from .plan import Shot, shots
from .scene import Scene
from .scenes import SCENES
from .settings import Quality, Settings, Source
from .sources.bodies_file import FileContents
from .vibration import Body, Motion, pixel_displacement, reach, solve


@dataclass(frozen=True)
class DatasetJob:
    """One dataset in the making."""

    settings: Settings  # with the cameras placed
    root: Path  # the dataset's folder
    bodies: tuple[Body, ...]
    motion: Motion
    shots: tuple[Shot, ...]
    unit_scale_m: float | None


def plan(settings: Settings, out: Path) -> DatasetJob:
    """Reads the geometry and lists the pictures. Raises GenerateError on bad input; nothing is written."""
    _check_packages(settings)
    if settings.device == "gpu":
        processes.single({"task": "device", "settings": settings.to_json()}, "trying the device")
    settings, bodies, unit_scale_m = placed(settings)
    motion = motion_of(settings, bodies)
    root = out / settings.folder
    return DatasetJob(settings, root, bodies, motion, tuple(shots(settings, motion)), unit_scale_m)


def claim(job: DatasetJob) -> DatasetJob:
    """Takes the folder and writes scene.json, the poses and truth/motion.npz; returns the job.

    Raises GenerateError if the folder holds anything else.
    """
    settings, root, bodies, motion = job.settings, job.root, job.bodies, job.motion
    amplitude = max(float(reach(shape[0]).max(initial=0.0)) for shape in motion.shapes)
    description = tree.describe(settings, amplitude, job.unit_scale_m, Quality.of(settings).describe())
    description |= {"blender_version": blender_version(), "package_version": __version__}
    if settings.source.path:
        source = {**asdict(settings.source), "path": Path(settings.source.path).name}
        description["source"] = {**source, "sha256": _digest(Path(settings.source.path))}
    tree.work_folder(root).claim(description)
    tree.write_poses(root, settings)
    truth.write_motion(root / "truth/motion.npz", bodies, motion, settings.timesteps)
    tree.write_cameras(root, settings, motion)
    return job


def motion_of(settings: Settings, bodies: tuple[Body, ...]) -> Motion:
    """The motion of all bodies; amplitudes in pixels are those of training camera 0 at timestep 0."""
    camera = cameras_at(settings.cameras, 0)["train"][0]
    focal = camera.focal(settings.size)

    def pixels(positions: np.ndarray, shape: np.ndarray) -> float:
        return pixel_displacement(positions, shape, camera.camera_to_world, focal, focal)

    return solve(settings.motion, bodies, settings.fps, pixels, settings.seed)


def builtin(name: str) -> Scene:
    """The description of a built-in scene. Raises GenerateError for an unknown name."""
    if name not in SCENES:
        raise GenerateError(f"scene {name!r} is not one of {', '.join(sorted(SCENES))}")
    return SCENES[name]()


def bodies_of(scene: Scene) -> tuple[Body, ...]:
    """The parts of a scene as what moves."""
    return tuple(
        Body(part.name, part.mesh.vertices, part.mesh.triangles, part.follow, {}) for part in scene.parts
    )


def builtin_bodies(name: str) -> tuple[Body, ...]:
    """The parts of a built-in scene. Raises GenerateError for an unknown name."""
    return bodies_of(builtin(name))


def placed(settings: Settings) -> tuple[Settings, tuple[Body, ...], float | None]:
    """The settings with the cameras around the scene, its bodies, and metres per scene unit if known.

    A user's file is opened by a process of its own, which Blender takes over.
    """
    if settings.source.kind == "builtin":
        scene = builtin(settings.scene)
        bodies = bodies_of(scene)
        return framed(settings, bodies), bodies, scene.unit_scale_m
    loaded = inspected(settings.source)
    cameras = settings.cameras.placed(loaded.centre, loaded.radius, loaded.cameras)
    return framed(replace(settings, cameras=cameras), loaded.bodies), loaded.bodies, loaded.unit_scale_m


def inspected(source: Source) -> FileContents:
    """Inspect a user's file in a separate process and print its warnings."""
    from .sources import bodies_file

    with tempfile.TemporaryDirectory(prefix="dataset_gen_") as scratch:
        file = Path(scratch) / "bodies.npz"
        processes.inspect(source, file)
        found = bodies_file.load(file)
    for warning in found.warnings:
        say("warning", str(warning), "warning: ")
    return found


def framed(settings: Settings, bodies: tuple[Body, ...]) -> Settings:
    """The settings with cameras that have in their pictures all that moves, test cameras also at the largest α.

    Amplitudes in pixels, which depend on where cameras stand, are taken from those that frame the scene at rest.
    """
    if settings.cameras.kind == "orbit":
        return settings
    rest = np.concatenate([body.vertices for body in bodies])
    at_rest = replace(settings, cameras=settings.cameras.framing(rest))
    motion = motion_of(at_rest, bodies)
    basis, times = np.concatenate(motion.basis, axis=1), np.arange(settings.timesteps)
    seen, magnified = (
        moving_points(rest, basis, motion.basis_gains(times, alpha))
        for alpha in (0.0, max(settings.alphas, default=0.0))
    )
    return replace(settings, cameras=settings.cameras.framing(seen, magnified))


def blender_version() -> str:
    """Version of the Blender that will render, without importing it (that costs seconds) where possible."""
    if "bpy" in sys.modules:
        return ".".join(str(n) for n in sys.modules["bpy"].app.version)
    try:
        return importlib.metadata.version("bpy")
    except importlib.metadata.PackageNotFoundError:
        raise GenerateError(
            f"bpy (Blender as a Python module) is not installed: {blender_remedy()}, or run this with "
            "blender --background --python dataset_gen/blender_main.py -- …"
        ) from None


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_packages(settings: Settings) -> None:
    if settings.effects.coded:
        codec.check_package()
    for wanted, option in (
        (settings.truth != "none", "--truth"),
        (settings.pictures.images == "exr", "--images exr"),
    ):
        if wanted and importlib.util.find_spec("OpenEXR") is None:
            raise GenerateError(
                f"{option} needs the package OpenEXR, which this Python lacks: "
                f"'{sys.executable}' -m pip install OpenEXR, or use --truth none and PNG images"
            )
