"""One process of a run: renders a range of shots and reports every finished one on a line of its own."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import TextIO

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from . import build, points, render, tree, truth
from .plan import Shot, shots
from .quality import Quality
from .run import DONE, point_view
from .scenes import SCENES
from .settings import Settings


def work(job_path: Path) -> int:
    """Does the job of a JSON file: {settings, root, shots: numbers, threads}. Returns the exit status."""
    job = json.loads(job_path.read_text())
    report = _own_stdout()
    settings = Settings.from_json(job["settings"])
    stage = build.build(SCENES[settings.scene](settings.frequency, settings.amplitude), settings.fps)
    quality = Quality.of(settings, job["threads"])
    render.configure(stage, quality)
    every = shots(settings, stage.motion)
    painter = _Painter(stage, settings, Path(job["root"]))

    def finished() -> None:
        report.write(f"{DONE}\n")
        report.flush()

    render_shots(stage, quality, [every[i] for i in job["shots"]], painter, finished)
    return 0


def _own_stdout() -> TextIO:
    """The real standard output for reports alone; what Blender prints goes nowhere."""
    channel = os.fdopen(os.dup(1), "w")
    sys.stdout.flush()
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)
    return channel


def render_shots(
    stage: build.Stage, quality: Quality, todo: list[Shot], painter: _Painter, finished: Callable[[], None]
) -> None:
    """Renders shots state by state: all pictures of a state, then all its data passes."""
    root = painter.root
    for state, group in groupby(todo, key=lambda shot: shot.state):
        batch = list(group)
        build.set_state(stage, state)
        render.use_picture(stage, quality)
        for shot in batch:
            _picture(stage, quality, shot, root)
            if shot.sees_rest:
                painter.paint(shot)
            if not shot.truth:
                finished()
        render.use_data(stage)
        for shot in batch:
            if shot.truth:
                _truth(stage, quality, shot, root)
                finished()


def _existing(root: Path, names: tuple[str, ...], quality: Quality) -> Path | None:
    """A complete file of a shot, if a former run left one."""
    paths = (root / name for name in names)
    return next((path for path in paths if tree.complete(path, quality.width, quality.height)), None)


def _picture(stage: build.Stage, quality: Quality, shot: Shot, root: Path) -> None:
    source = _existing(root, shot.images, quality)
    if source is None:
        source = root / shot.images[0]
        build.set_view(stage, shot.camera.camera_to_world)
        render.render_to(stage, source)
    tree.link(source, (root / name for name in shot.images))


def _truth(stage: build.Stage, quality: Quality, shot: Shot, root: Path) -> None:
    source = _existing(root, shot.truth, quality)
    if source is None:
        source = root / shot.truth[0]
        raw = tree.temporary_name(source.with_name(f"{source.stem}_raw.exr"))
        build.set_view(stage, shot.camera.camera_to_world)
        render.render_to(stage, raw)
        truth.write_exr(source, render.read_passes(raw))
        raw.unlink()
    tree.link(source, (root / name for name in shot.truth))


class _Painter:
    """Colours the candidates of points3d.ply from the training pictures of the rest state, view by view."""

    def __init__(self, stage: build.Stage, settings: Settings, root: Path) -> None:
        self.root = root
        self._settings = settings
        self._candidates = points.sample_surfaces(stage.description, settings.points, settings.seed)
        self._tree: BVHTree | None = None
        self._stage = stage

    def paint(self, shot: Shot) -> None:
        """Writes which candidates the view sees (nothing in between) and the colours it gives them."""
        path = point_view(self.root, shot)
        if path.exists() or not self._settings.points:
            return
        size = self._settings.size
        positions, normals = self._candidates.positions, self._candidates.normals
        eye = shot.camera.camera_to_world[:3, 3]
        to_eye = eye - positions
        distance = np.linalg.norm(to_eye, axis=1)
        facing = np.abs((to_eye * normals).sum(1)) / distance
        pixel, _ = points.project(positions, shot.camera, size, size)
        column, row = np.floor(pixel).astype(int).T
        candidate = (facing > 0.2) & (column >= 0) & (column < size) & (row >= 0) & (row < size)
        rgba = _load(self.root / shot.images[0], size)
        index = np.flatnonzero(candidate)
        index = index[rgba[row[index], column[index], 3] > 0.5]
        index = index[
            self._unhidden(positions[index], to_eye[index] / distance[index, None], distance[index])
        ]
        arrays = {"index": index, "colour": rgba[row[index], column[index], :3], "weight": facing[index] ** 2}
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = tree.temporary_name(path)
        np.savez(temporary, **arrays)
        os.replace(temporary, path)

    def _unhidden(self, positions: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> np.ndarray:
        if self._tree is None:
            parts = self._stage.description.parts
            starts = np.cumsum([0] + [len(part.mesh.vertices) for part in parts[:-1]])
            vertices = np.concatenate([part.mesh.vertices for part in parts])
            faces = np.concatenate([part.mesh.triangles + s for part, s in zip(parts, starts, strict=True)])
            self._tree = BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)
        cast = self._tree.ray_cast
        lifted = positions + 1e-3 * directions
        return np.array(
            [
                cast(Vector(p), Vector(d), r)[0] is None
                for p, d, r in zip(lifted.tolist(), directions.tolist(), distance.tolist(), strict=True)
            ],
            bool,
        )


def _load(path: Path, size: int) -> np.ndarray:
    """A written picture as [H, W, 4] sRGB in 0..1, row 0 at the top."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"  # leaves colours as they are stored, not multiplied by alpha
    pixels = np.empty(size * size * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(size, size, 4)[::-1]
