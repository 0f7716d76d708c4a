"""File > Import > TG4MM splats, and dropping such files into the 3D view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import SplatFile, read_head, read_splat
from tg4mm.core.splatfile.model import Options, parsed_frequencies
from tg4mm.core.splatfile.read import ENDINGS

from .. import compat, names, preferences
from ..declare import reports
from ..nodes import blending, changes, clock, drawing, points, scene
from ..nodes.axes import LABELS, stand_up
from ..nodes.blending import true_colours
from ..nodes.shapes import DRAW_MODES, available
from ..panels import framing
from . import sequence, splats

SEE = "the sidebar (N), TG4MM, lists what changed"
DEFORMED = "deformation.pth"  # of 4DGaussians: the network that moves its PLY
STILL = 1e-6  # of the largest motion: float32 holds no less beside it


@dataclass(frozen=True)
class Imported:
    """The objects that an import created, and messages about them."""

    objects: list[Any]
    message: str
    fps: float  # Hz; 0.0 if no file says
    n_timesteps: int
    upright: bool = False  # the format says what is up, and it is up


def load(
    paths: Sequence[Path],
    collection: Any,
    sequences: bool,
    most: int,
    step: Callable[[float], None],
    options: Options = Options(),  # noqa: B008, frozen
    fps: float = 0.0,
) -> Imported:
    """Import the chosen files, or those of a folder, into `collection`. `step(part)` is called as work goes on, 0 to 1.

    With `sequences`, static files numbered alike play one after another, and a single one brings the run that
    it is part of; where they share their Gaussians, their motion at `fps` frames a second is found (0: it is not).
    Raises SplatFileError for a file that cannot be read or for more than `most` Gaussians in all; then nothing is left
    behind.
    """
    if len(paths) == 1 and paths[0].is_dir():
        paths = sequence.of_folder(paths[0])
    heads = [read_head(path) for path in paths]
    moves = any(head.n_modes or (head.n_lost and options.freqs_hz) for head in heads)
    upright = all(head.y_up for head in heads)
    frames = sequence.as_sequence(paths) if sequences and not moves else None
    check_count(frames or paths, most)
    if frames is not None:
        return _load_sequence(frames, collection, step, options, upright, fps)
    splats = []
    for i, path in enumerate(paths):
        splats.append(moving_modes(_read(path, options)))
        step((i + 1) / (len(paths) + 1))
    objects = scene.make_objects(splats, [path.stem for path in paths], collection)
    count, modes = sum(len(splat) for splat in splats), sum(splat.n_modes for splat in splats)
    longest = max(splats, key=lambda splat: splat.n_timesteps)
    message = f"{count:,} Gaussians, {modes} mode{'' if modes == 1 else 's'}"
    still = [
        f"{path.name}: {DEFORMED} beside it, which moves it, is not read: shown still"
        for path in paths
        if not modes and path.with_name(DEFORMED).exists()
    ]
    notes = [
        f"{path.name}: {note}" for path, splat in zip(paths, splats, strict=True) for note in splat.notes
    ]
    return Imported(
        objects,
        "; ".join([message, *notes, *still]),
        longest.fps if modes else 0.0,
        longest.n_timesteps,
        upright,
    )


def _read(path: Path, options: Options) -> SplatFile:
    return read_splat(path, options.freqs_hz, options.fps, options.decode)


def moving_modes(splat: SplatFile) -> SplatFile:
    """Drop modes without motion: below STILL times the largest displacement, rotations included."""
    size = splat.scales.max()
    reach = np.array(
        [
            np.abs(d).max(initial=0.0) + size * np.abs(r).max(initial=0.0)
            for d, r in zip(splat.displacement, splat.rotation, strict=True)
        ]
    )
    keep = reach > STILL * reach.max(initial=0.0)
    if keep.all():
        return splat
    return replace(
        splat,
        freqs_hz=splat.freqs_hz[keep],
        displacement=splat.displacement[keep],
        rotation=splat.rotation[keep],
        deviation=None if splat.deviation is None else splat.deviation[keep],
    )


def check_count(paths: Sequence[Path], most: int) -> None:
    """Raise SplatFileError if the files hold more than `most` Gaussians in total; only headers are read."""
    total = sum(read_head(path).count for path in paths)
    if total > most:
        what = f"{paths[0]}: holds" if len(paths) == 1 else f"{paths[0].parent}: {len(paths)} files hold"
        raise SplatFileError(f"{what} {total:,} Gaussians, more than the limit Max Gaussians, {most:,}")


def _load_sequence(
    frames: list[Path],
    collection: Any,
    step: Callable[[float], None],
    options: Options,
    upright: bool,
    fps: float,
) -> Imported:
    """Import files as one object: with modes where `fps` (Hz) is not 0 and they share their Gaussians."""
    odd: dict[Path, None] = {}  # of which there was something to tell

    def read(path: Path) -> SplatFile:
        splat = _read(path, options)
        odd.update({path: None} if splat.notes else {})
        if splat.n_modes:
            raise SplatFileError(f"{path}: has motion and cannot be a frame of a sequence: import it alone")
        step((1 + frames.index(path)) / (1 + len(frames)))
        return splat

    same = fps > 0 and len({read_head(path).count for path in frames}) == 1
    splat = sequence.as_motion(map(read, frames), len(frames), fps) if same else None
    if splat is not None:
        obj = scene.make_objects([splat], [sequence.name_of(frames)], collection)[0]
        message = f"{len(frames)} frames of {len(splat):,} Gaussians, as {splat.n_modes} modes"
        message = "; ".join([message, *splat.notes])
    else:
        obj, most = scene.make_sequence(frames, sequence.name_of(frames), collection, read)
        message = f"{len(frames)} frames of up to {most:,} Gaussians"
    if missing := sequence.missing_beside(frames[0]):
        message += f"; missing file numbers: {', '.join(map(str, missing[:4]))}"
    if odd:
        message += f"; {len(odd)} changed on reading (see the console), first {next(iter(odd)).name}"
    return Imported([obj], message, fps if splat is not None else 0.0, len(frames), upright)


class IMPORT_SCENE_OT_tg4mm_splat(bpy.types.Operator, ImportHelper):
    """Import Gaussian splats with their motion as points that move"""

    bl_idname = "import_scene.tg4mm_splat"
    bl_label = "Import TG4MM Splats"
    bl_options = {"REGISTER", "UNDO", "PRESET"}  # noqa: RUF012

    filename_ext = ".ply"
    filter_glob: StringProperty(  # type: ignore[valid-type]
        default=";".join(f"*{ending}" for ending in ENDINGS), options={"HIDDEN"}
    )
    # SKIP_SAVE: else a file of the last import comes along with the next.
    files: CollectionProperty(  # type: ignore[valid-type]
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"}
    )
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})  # type: ignore[valid-type]
    sequence: BoolProperty(  # type: ignore[valid-type]
        name="As Sequence",
        description="Play numbered files without motion, such as name_0001.ply and name_0002.ply, one after "
        "another; one chosen file brings the whole run",
        default=True,
    )
    motion: BoolProperty(  # type: ignore[valid-type]
        name="Find Motion",
        description="Where the files of a sequence hold the same Gaussians in the same order, turn their motion into "
        "modes, so that it can be magnified",
        default=True,
    )
    timeline: BoolProperty(  # type: ignore[valid-type]
        name="Set Timeline",
        description="Set frame rate (Hz), frame range and slow motion from a file with motion, and show a frame with "
        "large motion, unless the scene is animated already",
        default=True,
    )
    colours: BoolProperty(  # type: ignore[valid-type]
        name="True Colours",
        description="Set the scene's view transform to Standard, as other splat viewers show the colours, and Cycles' "
        "transparent bounces high enough for splats",
        default=True,
    )
    show: BoolProperty(  # type: ignore[valid-type]
        name="Frame in View",
        description="Frame the splats in the 3D views and in the untouched startup camera, hide the untouched startup "
        "cube where it is in the way, and switch Solid view, which shows splats grey, to Material Preview",
        default=True,
    )
    axes: EnumProperty(  # type: ignore[valid-type]
        name="Up",
        description="The axis that points up in the file; the object is rotated so that it points up here",
        items=[
            (
                splats.CAMERAS,
                "By Its Cameras",
                "As SPZ and glTF, cameras.json or transforms.json beside it say, else Z up",
            ),
            (splats.FILE, "Z", "The convention of Blender: no rotation"),
            (splats.MINUS_Y, "−Y", "The convention of COLMAP and 3DGS"),
            (splats.PLUS_Y, "Y", "The convention of glTF and most viewers"),
        ],
        default=splats.CAMERAS,
    )
    frequencies: StringProperty(  # type: ignore[valid-type]
        name="Frequencies",
        description="Hz, such as 5, 7.5, one for each mode, for a file that lost them in another program; without "
        "them it is imported without motion",
        options={"SKIP_SAVE"},
    )
    most: IntProperty(  # type: ignore[valid-type]
        name="Max Gaussians",
        description="Refuse files with more Gaussians in all than this, before reading them",
        default=5_000_000,
        min=1,
    )

    def invoke(self, context: Any, event: Any) -> set[str]:
        if not self.properties.is_property_set("most"):
            self.most = preferences.get(context).most
        if self.directory and self.files:  # dropped into the view
            return self.execute(context)
        return ImportHelper.invoke(self, context, event)

    @reports("read")
    def execute(self, context: Any) -> set[str]:
        if context.mode != "OBJECT":  # else the object that is edited stays so, without being the active one
            bpy.ops.object.mode_set(mode="OBJECT")
        into = points.receiving(context)
        manager = context.window_manager
        manager.progress_begin(0, 100)
        try:
            loaded = load(
                self._paths(),
                into,
                self.sequence,
                self.most,
                lambda part: manager.progress_update(int(100 * part)),
                Options(parsed_frequencies(self.frequencies), clock.rate(context.scene), blending.decode),
                clock.rate(context.scene) if self.motion else 0.0,
            )
        except MemoryError:
            self.report({"ERROR"}, f"{self._paths()[0]}: not enough memory for it")
            return {"CANCELLED"}
        finally:
            manager.progress_end()
        notes = self._stand_up(loaded)
        for obj in loaded.objects:
            notes += _draw_as(obj, preferences.get(context).draw_as)
        _select(context, loaded.objects)
        if self.show:
            notes += framing.show(context, loaded.objects)
        if self.timeline:
            notes += scene.set_timeline(context.scene, loaded.objects, loaded.fps, loaded.n_timesteps)
        if self.colours:
            true_colours(context.scene)
        if into != context.collection:
            notes.append(f"In {into.name}, as {context.collection.name} is hidden or linked")
        for obj in loaded.objects:
            obj[names.NOTES] = "\n".join(notes)
        changed = len(changes.listed(context.scene)) + len(notes)
        self.report({"INFO"}, f"{loaded.message}{f'; {SEE}' if changed else ''}")
        return {"FINISHED"}

    def _stand_up(self, loaded: Imported) -> list[str]:
        """Rotate the objects so that the file's up axis is Z; return a message."""
        axes, said = self.axes, ""
        if axes == splats.CAMERAS and loaded.upright:
            return ["Y is up in this format: rotated to Z up"]
        if axes == splats.CAMERAS:
            axes, said = splats.up_axis(self._paths()[0]) or (splats.FILE, "")
        if axes == splats.FILE:
            return []
        for obj in loaded.objects:
            stand_up(obj, axes)
        return [f"Rotated, because {said} shows {LABELS[axes]} up"] if said else []

    def _paths(self) -> list[Path]:
        folder = Path(bpy.path.abspath(self.directory))
        chosen = [folder / file.name for file in self.files if file.name]
        return chosen or [Path(bpy.path.abspath(self.filepath))]


class IO_FH_tg4mm_splat(bpy.types.FileHandler):
    bl_idname = "IO_FH_tg4mm_splat"
    bl_label = "TG4MM Splats"
    bl_import_operator = IMPORT_SCENE_OT_tg4mm_splat.bl_idname
    bl_file_extensions = ";".join(ending for ending in ENDINGS if ending != ".json")

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}


def _draw_as(obj: Any, wanted: str) -> list[str]:
    """Apply the requested draw mode, or the best one for the object; return a message."""
    mesh = scene.first_mesh(obj)
    if wanted not in available(scene.moves(obj)):  # Automatic, or what this file has not
        wanted = drawing.best(len(mesh.vertices), len(obj[names.FREQUENCIES]))
    compat.set_input(scene.splat_modifier(obj), names.DRAW, wanted)
    far, span = drawing.far_out(mesh) if DRAW_MODES[wanted].native else (0, 0.0)
    return [f"{far:,} outliers span {span:.2g} times its size: all positions lose precision"] if far else []


def _select(context: Any, objects: list[Any]) -> None:
    """Make the imported object active but not selected: selection outlines would hide the splats' colours."""
    for other in (*context.selected_objects, *objects):
        other.select_set(False)
    context.view_layer.objects.active = objects[0]


def _menu(self: Any, context: Any) -> None:
    self.layout.operator(
        IMPORT_SCENE_OT_tg4mm_splat.bl_idname, text="TG4MM Splats (.ply, .splat, .spz, .sog, .glb)"
    )


def register() -> None:
    bpy.utils.register_class(IMPORT_SCENE_OT_tg4mm_splat)
    bpy.utils.register_class(IO_FH_tg4mm_splat)
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(IO_FH_tg4mm_splat)
    bpy.utils.unregister_class(IMPORT_SCENE_OT_tg4mm_splat)
