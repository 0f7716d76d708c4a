"""One process inside Blender: renders a range of shots, looks into a user's file, or saves an animation."""

import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, TextIO

import bpy
import numpy as np

from . import build, render, tree, truth
from .cameras import cameras_at
from .compat import use_device
from .effects import RecordingEffects, record
from .effects.record import bands, moments
from .errors import GenerateError
from .painter import Painter
from .plan import PlannedPicture, Shot, shots
from .prepare import bodies_of, builtin, motion_of
from .processes import DONE, NOTE, REFUSED
from .settings import Quality, Settings, Source
from .sources.assemble import LoadedScene
from .vibration import Body, State

_NEXT_SEED = 7_368_787  # between the moments of an exposure, so that their noise is not the same


def work(job_path: Path) -> int:
    """Do the task of a JSON file and return the exit status."""
    job = json.loads(job_path.read_text(encoding="utf-8"))
    report = _own_stdout()
    tasks = {"render": _render_shots, "inspect": _inspect, "animate": _animate, "device": _device}
    try:
        tasks[job["task"]](job, report)
    except GenerateError as error:
        print(error, file=sys.stderr)
        return REFUSED
    return 0


def _own_stdout() -> TextIO:
    """The real standard output for reports alone; what Blender prints goes nowhere."""
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    sys.stdout.flush()
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)
    return channel


def load_stage(settings: Settings) -> tuple[build.Stage, tuple[Body, ...]]:
    """The scene inside Blender at rest, and its geometry."""
    if settings.source.kind == "builtin":
        scene = builtin(settings.scene)
        return build.build(scene), bodies_of(scene)
    loaded = open_source(settings.source)
    return loaded.stage, loaded.bodies


def open_source(source: Source) -> LoadedScene:
    """The user's file, in this process."""
    from .sources import open_blend, open_mesh

    if source.kind == "mesh":
        return open_mesh(Path(source.path))
    return open_blend(Path(source.path), frame=source.frame, scene=source.scene)


def _inspect(job: dict[str, Any], report: TextIO) -> None:
    from .sources import bodies_file

    bodies_file.save(Path(job["found"]), open_source(Source(**job["source"])))


def _device(job: dict[str, Any], report: TextIO) -> None:
    use_device(bpy.context.scene, job["settings"]["device"])


def _animate(job: dict[str, Any], report: TextIO) -> None:
    from .animate import save_animation

    settings = Settings.from_json(job["settings"])
    stage, bodies = load_stage(settings)
    motion = motion_of(settings, bodies)
    cameras = partial(cameras_at, settings.cameras)
    missing = save_animation(stage, motion, settings.timesteps, Path(job["path"]), cameras, settings.size)
    for name in missing:
        report.write(f"{NOTE}{name} could not be packed into the file: its own file is missing\n")


def _render_shots(job: dict[str, Any], report: TextIO) -> None:
    settings, root = Settings.from_json(job["settings"]), Path(job["root"])
    stage, bodies = load_stage(settings)
    motion = motion_of(settings, bodies)
    quality = Quality.of(settings, job["threads"])
    device = render.configure(stage, quality)
    if settings.device != "cpu":
        report.write(f"{NOTE}Cycles renders on {device}\n")
    every = shots(settings, motion)

    def move(state: State) -> None:
        build.move(stage, [motion.displacement(i, state) for i in range(len(bodies))])

    photographer = _Photographer(stage, settings, quality, root, Painter(bodies, settings, root), move)
    todo = [every[i] for i in job["shots"]]
    for state, group in groupby(todo, key=lambda shot: shot.state):
        batch = list(group)
        move(state)
        for take in (photographer.picture, photographer.truth):
            for shot in batch:
                if take(shot):
                    report.write(f"{DONE}\n")
                    report.flush()


# Linear light [H, W, 4] of one of a shot's pictures; of None, as the camera stands.
Take = Callable[[PlannedPicture | None], np.ndarray]
_Rasters = dict[str, np.ndarray]  # [H, W, ...]


class _Photographer:
    def __init__(
        self,
        stage: build.Stage,
        settings: Settings,
        quality: Quality,
        root: Path,
        painter: Painter,
        move: Callable[[State], None],
    ) -> None:
        self._stage, self._settings, self._quality = stage, settings, quality
        self._root, self._painter, self._move = root, painter, move
        self._record = RecordingEffects(settings.effects, settings.cameras, settings.size, settings.seed)

    def picture(self, shot: Shot) -> bool:
        """The pictures of a shot; True if the shot is done with that."""
        missing = [p for p in shot.pictures if not self._complete(p.path)]
        if missing or self._painter.wants(shot):
            if self._alike(shot) and not self._painter.wants(shot):
                self._link_or_render(shot)
            else:
                self._render(shot)
        return not shot.truth

    def _alike(self, shot: Shot) -> bool:
        gain = self._record.gain(shot.split, shot.camera, 0)
        return self._settings.sensor is None and gain is None and not self._shakes(shot)

    def _shakes(self, shot: Shot) -> bool:
        return self._record.shakes(shot.split, shot.camera)

    def _link_or_render(self, shot: Shot) -> None:
        whole = next((p.path for p in shot.pictures if self._complete(p.path)), None)
        if whole is None:
            self._render(shot)
        else:
            tree.link(self._root / whole, (self._root / p.path for p in shot.pictures))

    def _render(self, shot: Shot) -> None:
        take = self._shaken(shot) if self._shakes(shot) else self._steady(shot)
        if self._painter.wants(shot):
            self._painter.paint(shot, take(None))
        if self._alike(shot):
            first = self._root / shot.pictures[0].path
            tree.write_bytes(first, self._encode(shot, shot.pictures[0], take))
            tree.link(first, (self._root / p.path for p in shot.pictures))
            return
        for picture in shot.pictures:
            tree.write_bytes(self._root / picture.path, self._encode(shot, picture, take))

    def _steady(self, shot: Shot) -> Take:
        build.set_view(self._stage, shot.camera)
        if shot.blur:
            linear = self._blurred(shot)
        else:
            render.use_picture(self._stage, self._quality, shot.seed_offset)
            linear = self._seen(shot, lambda: {"": render.linear_picture(self._stage)})[""]
        return lambda picture: linear

    def _blurred(self, shot: Shot) -> np.ndarray:
        """The mean over the exposure, each moment with a part of the light paths; the shot's state is left behind."""
        shares = [share for share, _ in moments(self._settings.effects.shutter_ms / 1e3)]
        quality = replace(self._quality, samples=-(-self._quality.samples // len(shares)))
        total = np.zeros((quality.height, quality.width, 4))
        for i, (share, state) in enumerate(zip(shares, shot.blur, strict=True)):
            self._move(state)
            render.use_picture(self._stage, quality, shot.seed_offset + i * _NEXT_SEED)
            total += share * render.linear_picture(self._stage)
        self._move(shot.state)
        return np.asarray(total, np.float32)

    def _seen(self, shot: Shot, render_once: Callable[[], _Rasters]) -> _Rasters:
        """Render the shot's row bands, each in the state of its own time, then restore the shot's state."""
        if not shot.rows:
            return render_once()
        size = self._settings.size
        out: _Rasters = {}
        parts = bands(size, self._settings.effects.readout_ms / 1e3)
        for (rows, _), state in zip(parts, shot.rows, strict=True):
            self._move(state)
            with render.rows_alone(self._stage, rows, size):
                for name, raster in render_once().items():
                    out.setdefault(name, np.zeros_like(raster))[rows] = raster[rows]
        self._move(shot.state)
        return out

    def _shaken(self, shot: Shot) -> Take:
        camera, size = shot.camera, self._settings.size
        margin = self._record.margin(camera)
        quality = self._quality.finer(record.fine_size(size, margin), record.FINENESS)
        build.set_view(self._stage, record.fine_camera(camera, size, margin))
        render.use_picture(self._stage, quality, shot.seed_offset)
        fine = render.linear_picture(self._stage)

        def take(picture: PlannedPicture | None) -> np.ndarray:
            turn = np.zeros(3) if picture is None else self._record.turn(camera, picture.timestep)
            return record.frame(fine, camera, size, margin, turn)

        return take

    def _encode(self, shot: Shot, picture: PlannedPicture, take: Take) -> bytes:
        # The key names the frame, so that its noise is the same whichever process takes it, and when.
        key = (self._settings.seed + shot.seed_offset, shot.split, picture.timestep, shot.camera.name)
        gain = self._record.row_gains(shot.split, shot.camera, picture.timestep)
        pictures, sensor = self._settings.pictures, self._settings.sensor
        return pictures.encode(take(picture), sensor, (*key, int(picture.alpha)), gain)

    def truth(self, shot: Shot) -> bool:
        """The data passes of a shot; True if there were any to take."""
        if not shot.truth:
            return False
        source = next((name for name in shot.truth if self._complete(name)), None)
        if source is None:
            source = shot.truth[0]
            build.set_view(self._stage, shot.camera)
            render.set_size(self._stage, self._quality)
            render.use_data(self._stage)
            truth.write_exr(self._root / source, self._seen(shot, lambda: render.data_passes(self._stage)))
        tree.link(self._root / source, (self._root / name for name in shot.truth))
        return True

    def _complete(self, name: str) -> bool:
        return tree.complete(self._root, name, self._settings)
