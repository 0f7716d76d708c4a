"""The built-in hot dogs: parts, closed bodies, contacts, and what may move."""

from pathlib import Path

import numpy as np
import pytest

from dataset_gen.meshes import triangle_areas
from dataset_gen.scenes import hotdog
from dataset_gen.vibration.bodies import Body
from dataset_gen.vibration.describe import read_motion
from dataset_gen.vibration.solve import solve


@pytest.fixture(scope="module")
def scene():
    return hotdog.build()


@pytest.fixture(scope="module")
def parts(scene):
    return {part.name: part for part in scene.parts}


@pytest.fixture(scope="module")
def shapes(scene):
    bodies = [Body(p.name, p.mesh.vertices, p.mesh.triangles, p.follow) for p in scene.parts]
    motion = solve(read_motion(Path(hotdog.__file__).with_suffix(".yaml")), bodies, 30.0, None, 0)
    return {body.name: shape[0] for body, shape in zip(bodies, motion.shapes, strict=True)}


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return (a * np.cross(b, c)).sum() / 6.0


def open_edges(mesh):
    """Edges that are not walked once in each direction; positions decide, so that doubled seams count as joined."""
    _, same = np.unique(mesh.vertices.round(7), axis=0, return_inverse=True)
    t = same.reshape(-1)[mesh.triangles].astype(np.int64)
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    forth, back = (np.sort(edges @ k) for k in ([len(same), 1], [1, len(same)]))
    return len(np.setxor1d(forth, back))


def test_two_hot_dogs_lie_on_a_plate(parts):
    both = {f"{what}_{side}" for what in ("bun", "sausage", "seeds") for side in ("left", "right")}
    assert set(parts) == both | {"plate", "mustard_left", "ketchup_right", "crumbs", "drops"}


def test_it_has_the_scale_of_the_published_scene(scene):
    points = np.concatenate([part.mesh.vertices for part in scene.parts])
    assert np.isfinite(points).all()
    assert 1.2 < np.linalg.norm(points, axis=1).max() < 1.45
    assert 60_000 <= sum(len(part.mesh.triangles) for part in scene.parts) <= 300_000


@pytest.mark.parametrize(
    "name", ["plate", "bun_left", "bun_right", "sausage_left", "mustard_left", "ketchup_right"]
)
def test_bodies_are_closed_and_face_outwards(parts, name):
    assert open_edges(parts[name].mesh) == 0
    assert volume(parts[name].mesh) > 1e-4


def test_an_open_body_would_be_noticed(parts):
    mesh = parts["bun_left"].mesh
    assert open_edges(type(mesh)(mesh.vertices, mesh.triangles[1:], mesh.uv[1:])) > 0


def test_buns_lie_flat_on_the_plate_and_do_not_touch_each_other(parts):
    for name in ("bun_left", "bun_right"):
        z = parts[name].mesh.vertices[:, 2]
        assert 0.0 < z.min() - hotdog.FLOOR < 0.006
        assert (z < hotdog.FLOOR + 0.01).sum() > 100
    assert parts["bun_left"].mesh.vertices[:, 1].min() > parts["bun_right"].mesh.vertices[:, 1].max() + 0.02


def test_sauce_rests_on_its_sausage(parts):
    spatial = pytest.importorskip("scipy.spatial")
    for sauce, sausage in (("mustard_left", "sausage_left"), ("ketchup_right", "sausage_right")):
        tree = spatial.cKDTree(parts[sausage].mesh.vertices)
        near, _ = tree.query(parts[sauce].mesh.vertices)
        assert near.max() < 0.09
        assert np.quantile(near, 0.1) < 0.02


def test_only_what_should_move_moves(shapes):
    peak = {name: np.linalg.norm(np.abs(shape), axis=1).max() for name, shape in shapes.items()}
    assert max(peak.values()) == pytest.approx(0.005)
    for name, size in peak.items():
        assert (size > 0.0005) == name.startswith(("bun_", "sausage_", "mustard_", "ketchup_", "seeds_")), (
            name
        )


def test_parts_that_touch_move_together(scene, shapes):
    spatial = pytest.importorskip("scipy.spatial")
    group = [part for part in scene.parts if part.name.endswith("_left") or part.name == "plate"]
    owner = np.repeat(np.arange(len(group)), [len(part.mesh.vertices) for part in group])
    points = np.concatenate([part.mesh.vertices for part in group])
    moves = np.concatenate([shapes[part.name] for part in group])
    pairs = spatial.cKDTree(points).query_pairs(0.012, output_type="ndarray")
    pairs = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]]
    assert len(pairs) > 100  # parts do touch
    jump = np.linalg.norm(np.abs(moves[pairs[:, 0]] - moves[pairs[:, 1]]), axis=1)
    assert jump.max() < 0.1 * 0.005


def test_meshes_and_textures_are_sound(scene):
    for part in scene.parts:
        mesh, surface = part.mesh, part.surface
        assert mesh.triangles.max() < len(mesh.vertices)
        assert mesh.uv.shape == (*mesh.triangles.shape, 2)
        assert np.isfinite(mesh.uv).all()
        assert triangle_areas(mesh.vertices, mesh.triangles).min() > 0
        for picture in (surface.colour, surface.relief, surface.roughness):
            if picture is not None:
                assert np.min(picture) >= 0
                assert np.max(picture) <= 1
        assert surface.colour.std(axis=(0, 1)).max() > 0.02  # a plain colour would hide the motion


def test_it_is_the_same_each_time(scene):
    for one, two in zip(scene.parts, hotdog.build().parts, strict=True):
        np.testing.assert_array_equal(one.mesh.vertices, two.mesh.vertices)
        np.testing.assert_array_equal(one.surface.colour, two.surface.colour)
