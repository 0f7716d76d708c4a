"""`generate all --preset smoke`, fewer timesteps, one α: every scene generates, and its truth is what it says."""

import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
OpenEXR = pytest.importorskip("OpenEXR")
Image = pytest.importorskip("PIL.Image")

from mathutils import Vector  # noqa: E402
from mathutils.bvhtree import BVHTree  # noqa: E402

from dataset_gen import build, render, truth  # noqa: E402
from dataset_gen.cameras import SceneCamera, cameras_at  # noqa: E402
from dataset_gen.options import parser, request_from  # noqa: E402
from dataset_gen.prepare import builtin_bodies, motion_of  # noqa: E402
from dataset_gen.scenes import NAMES, SCENES  # noqa: E402
from dataset_gen.settings import Quality, Settings  # noqa: E402
from dataset_gen.vibration import Body, Motion  # noqa: E402

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
NOW = 1  # timestep of the checks: nothing is at rest there
OPTIONS = ["--preset", "smoke", "--timesteps", "3", "--alphas", "50"]  # and no more than the checks look at
REACH = 2e-2  # scene units: triangles farther from a point, as the tree sees it, are not looked at


@dataclass
class World:
    """One generated set, and the same scene in this process."""

    root: Path
    settings: Settings
    bodies: tuple[Body, ...]
    motion: Motion
    stage: build.Stage
    quality: Quality
    camera: SceneCamera

    def displacements(self, state):
        return [self.motion.displacement(i, state) for i in range(len(self.bodies))]

    def take(self, displacements, seed_offset=0):
        """Linear light [H, W, 4]; another offset gives other noise."""
        build.move(self.stage, displacements)
        build.set_view(self.stage, self.camera)
        render.use_picture(self.stage, self.quality, seed_offset)
        return render.linear_picture(self.stage)

    def exr(self, timestep):
        return truth.read_exr(self.root / f"truth/test/{timestep:03d}/{self.camera.name}.exr")


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    out = tmp_path_factory.mktemp("all")
    command = [sys.executable, "-m", "dataset_gen", "all", *OPTIONS, "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module", params=NAMES)
def world(request, sets):
    settings = request_from(parser().parse_args([request.param, *OPTIONS, "--out", str(sets)])).sets[0]
    bodies = builtin_bodies(request.param)
    quality = Quality.of(settings, 1)
    stage = build.build(SCENES[request.param]())
    render.configure(stage, quality)
    camera = cameras_at(settings.cameras, NOW)["test"][0]
    return World(
        sets / settings.folder, settings, bodies, motion_of(settings, bodies), stage, quality, camera
    )


def pixels(path):
    return np.asarray(Image.open(path)).astype(int)


def test_depth_and_pose_lead_onto_the_moved_surface(world):
    data = world.exr(NOW)
    points = unprojected(data["Depth"], world.camera)
    assert len(points) > 300
    here = Surface.of(world.bodies, world.displacements(world.motion.state(NOW)))
    # The point seen lies on the surface; the one at its depth on the pixel's ray is beside it by what Position is off.
    beside = np.linalg.norm(data["Position"][data["Depth"] < 1e9] - points, axis=1)
    assert (here.distance(points) < beside + 1e-6).all()
    assert np.percentile(beside, 99) < 1e-5
    elsewhere = Surface.of(world.bodies, world.displacements(world.motion.state(NOW, 50.0)))
    assert (elsewhere.distance(points) > 1e-3).mean() > 0.1


def test_the_displacement_pass_is_the_analytic_motion(world):
    data = world.exr(NOW)
    seen = data["Depth"] < 1e9
    position, moved = (data[name][seen].astype(float) for name in ("Position", "Displacement"))
    rest = Surface.of(world.bodies)
    displacements = world.displacements(world.motion.state(NOW))
    assert np.abs(moved).max() > 1e-3
    errors = displacement_errors(position, moved, rest, displacements)
    assert errors.max() < 3e-7  # every pixel; 2.5 units in the last place of a position
    wrong = displacement_errors(position, 1.1 * moved, rest, displacements)
    assert np.percentile(wrong, 98) > 1e-5


def test_optical_flow_is_the_projected_displacement(world, tmp_path):
    alpha, states = 20.0, {}
    for t in (NOW, NOW + 1):
        states[t] = world.displacements(world.motion.state(t, alpha))
    build.move(world.stage, states[NOW])
    build.set_view(world.stage, world.camera)
    render.use_data(world.stage)
    data = render.data_passes(world.stage)
    seen = data["Depth"] < 1e9
    position, moved = (data[name][seen].astype(float) for name in ("Position", "Displacement"))
    expected = expected_flow(
        position, moved, Surface.of(world.bodies), states[NOW + 1], world.camera, world.settings.size
    )
    got = _flow_to_next(world, states, tmp_path / "v.exr")[seen]
    error = np.abs(got - expected).max(1)
    assert np.percentile(error, 98) < 5e-3
    if np.abs(expected).max() > 0.2:  # at 5 Hz timesteps 1 and 2 are one state
        assert np.percentile(np.abs(got + expected).max(1), 98) > 0.1


def _flow_to_next(world, states, path):
    """[H, W, 2] pixels to the next frame, y down, by Blender's Vector pass of a mesh that two keyframes move."""
    scene = world.stage.scene
    for i, obj in enumerate(world.stage.objects):
        obj.shape_key_add(name="Basis")
        for t in states:
            key = obj.shape_key_add(name=str(t), from_mix=False)
            vertices = world.stage.rest[i] + states[t][i]
            key.data.foreach_set("co", vertices.astype(np.float32).ravel())
            for frame in states:
                key.value = float(frame == t)
                key.keyframe_insert("value", frame=frame)
    scene.frame_set(NOW)
    layer = scene.view_layers[0]
    layer.use_pass_vector = True
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    layer.use_pass_vector = False
    for obj in world.stage.objects:
        obj.shape_key_clear()
    with OpenEXR.File(str(path), separate_channels=True) as file:
        found = {}
        for name, channel in file.channels().items():
            if match := re.search(r"(?:^|\.)Vector\.([A-Z])$", name):
                found[match.group(1)] = channel.pixels
    return np.stack([-found["Z"], found["W"]], -1)  # now − next, y up


@dataclass(frozen=True)
class Surface:
    """All bodies of a scene as one mesh, in one pose."""

    vertices: np.ndarray  # [V, 3] float64
    triangles: np.ndarray  # [F, 3]
    tree: BVHTree

    @classmethod
    def of(cls, bodies, displacements=None):
        """At rest, or with every body displaced [V, 3]."""
        starts = np.cumsum([0] + [len(body.vertices) for body in bodies[:-1]])
        vertices = np.concatenate([body.vertices for body in bodies])
        if displacements is not None:
            vertices = vertices + np.concatenate(displacements)
        triangles = np.concatenate([b.triangles + s for b, s in zip(bodies, starts, strict=True)])
        tree = BVHTree.FromPolygons(vertices.tolist(), triangles.tolist(), all_triangles=True)
        return cls(vertices, triangles, tree)

    def feet(self, point):
        """Corners [F, 3], barycentric weights [F, 3] and distances [F] of the nearest points of all triangles near [3].

        In float64. The tree only proposes triangles: its own nearest points are float32, and off by up to 1e-3 on
        slivers (the ship's spars).
        """
        faces = [face for _, _, face, _ in self.tree.find_nearest_range(Vector(point), REACH)]
        corners = self.triangles[faces]
        return corners, *_nearest(point, self.vertices[corners])

    def distance(self, points):
        """[P] of points [P, 3] to the surface, scene units; infinity beyond REACH."""
        return np.array([self.feet(point)[2].min(initial=np.inf) for point in points])

    def foot(self, points):
        """Corners [P, 3] and barycentric weights [P, 3] of the surface point nearest to each of [P, 3]."""
        found = [self.feet(point) for point in points]
        best = [int(distances.argmin()) for _, _, distances in found]
        return tuple(np.array([f[k][b] for f, b in zip(found, best, strict=True)]) for k in (0, 1))


def _nearest(point, corners):
    """Weights [F, 3] and distances [F] of the points of triangles [F, 3, 3] that are nearest to [3]."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = point - a
    uu, vv, uv, wu, wv = (np.einsum("fc,fc->f", x, y) for x, y in ((u, u), (v, v), (u, v), (w, u), (w, v)))
    area = uu * vv - uv * uv
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    tried = [np.stack([1 - s - t, s, t], -1)]
    allowed = [(s >= 0) & (t >= 0) & (s + t <= 1)]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, j] - corners[:, i]
        share = np.einsum("fc,fc->f", point - corners[:, i], edge) / np.einsum("fc,fc->f", edge, edge)
        weights = np.zeros((len(corners), 3))
        weights[:, j] = np.clip(share, 0.0, 1.0)
        weights[:, i] = 1.0 - weights[:, j]
        tried.append(weights)
        allowed.append(np.ones(len(corners), bool))
    every = np.stack(tried)
    away = np.linalg.norm(np.einsum("kfn,fnc->kfc", every, corners) - point, axis=-1)
    away = np.where(np.stack(allowed), away, np.inf)
    which, face = away.argmin(0), np.arange(len(corners))
    return every[which, face], away[which, face]


def unprojected(depth, camera):
    """World points [P, 3] of the seen pixels of a planar depth map [H, W], row by row, from pose and lens alone."""
    height, width = depth.shape
    row, column = np.nonzero(depth < 1e9)
    focal = 0.5 * width / np.tan(0.5 * camera.angle_x)
    z = depth[row, column].astype(np.float64)
    local = np.column_stack(
        [(column + 0.5 - width / 2) * z / focal, -(row + 0.5 - height / 2) * z / focal, -z]
    )
    return local @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]


def displacement_errors(position, displacement, rest, displacements):
    """[P] differences between the displacement pass and the mode shapes at the material points that pixels see.

    Undone by its displacement, a point seen must lie on the surface at rest: where it does not, the difference is
    its distance from it. Where two parts touch, the point may be of either.
    """
    moves = np.concatenate(displacements)
    errors = np.full(len(position), np.inf)
    for i, (place, moved) in enumerate(zip(position, displacement, strict=True)):
        corners, weights, away = rest.feet(place - moved)
        off = np.abs(np.einsum("fk,fkc->fc", weights, moves[corners]) - moved).max(1)
        errors[i] = np.maximum(off, away).min(initial=np.inf)
    return errors


def expected_flow(
    position,  # [P, 3] of material points now
    displacement,  # [P, 3] of them now
    rest,
    there,  # displacements of every body at the other time
    camera,
    size,
):
    """[P, 2] pixels by which each point lies elsewhere at the other time, y down."""
    corners, weights = rest.foot(position - displacement)
    other = np.einsum("pk,pkc->pc", weights, np.concatenate(there)[corners])
    now, _ = camera.project(position, size, size)
    then, _ = camera.project(position - displacement + other, size, size)
    return then - now
