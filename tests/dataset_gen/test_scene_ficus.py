"""The built-in ficus: parts, size, leaves as closed shells, what holds what, pictures, and what moves."""

import numpy as np
import pytest

from dataset_gen.cameras import test_cameras as the_test_cameras
from dataset_gen.cameras import train_cameras
from dataset_gen.patterns import foliage
from dataset_gen.scenes import ficus
from dataset_gen.shapes import growth, leaf, pebbles
from tests.dataset_gen.builtin import volume

STILL = {"pot", "saucer", "soil", "pebbles", "fallen"}


SCENE = "ficus"


def some_leaves(n):
    ones = np.ones(n)
    return leaf.Leaves(
        0.14 * ones, 0.06 * ones, 0.6 * ones, 0.2 * ones, 0.1 * ones, ones, 2 * np.arange(n) % 8
    )


def test_a_potted_tree_of_many_clusters(parts):
    clusters = [name for name in parts if name.startswith("leaves_")]
    assert 20 <= len(clusters) <= 40
    assert set(parts) == STILL | {"trunk"} | set(clusters)
    assert 60_000 <= sum(len(part.mesh.triangles) for part in parts.values()) <= 300_000


def test_every_camera_sees_all_of_it(scene):
    points = np.concatenate([part.mesh.vertices for part in scene.parts])
    assert np.linalg.norm(points, axis=1).max() > 1.0
    for camera in train_cameras(30) + the_test_cameras(10):
        local = (points - camera.camera_to_world[:3, 3]) @ camera.camera_to_world[:3, :3]
        assert np.abs(local[:, :2] / local[:, 2:]).max() < np.tan(0.3455556)  # half of the field of view


def test_limbs_grow_out_of_the_trunk_and_nothing_hangs_below_the_rim_inside_the_pot(parts):
    spatial = pytest.importorskip("scipy.spatial")
    tree = spatial.cKDTree(parts["trunk"].mesh.vertices)
    for name, part in parts.items():
        if name.startswith("leaves_"):
            assert tree.query(part.mesh.vertices)[0].min() < 0.02, name
            points = part.mesh.vertices
            over = np.hypot(points[:, 0], points[:, 1]) < 0.31
            assert (points[over, 2] > ficus.ground(points[over, 0], points[over, 1])).all(), name


def test_pebbles_lie_on_the_soil_inside_the_pot(parts):
    stones = parts["pebbles"].mesh.vertices
    assert np.hypot(stones[:, 0], stones[:, 1]).max() < 0.318
    height = stones[:, 2] - ficus.ground(stones[:, 0], stones[:, 1])
    assert height.min() < 0.0 < height.max() < 0.03
    assert parts["saucer"].mesh.vertices[:, 2].min() == ficus.FLOOR


def test_the_pot_is_still_and_the_rest_moves(parts, moves):
    assert {name for name, shapes in moves.items() if not np.abs(shapes).any()} == STILL
    trunk = parts["trunk"].mesh.vertices[:, 2]
    np.testing.assert_array_equal(moves["trunk"][:, trunk <= -0.6], 0.0)
    size = np.linalg.norm(np.abs(moves["trunk"][0]), axis=1)
    assert size[trunk > 0.7].min() > size[trunk < 0.3].max()
    largest = [max(np.linalg.norm(np.abs(s[k]), axis=1).max() for s in moves.values()) for k in range(2)]
    np.testing.assert_allclose(largest, [0.005, 0.002])


def test_clusters_rustle_each_in_its_own_time(moves):
    turns = []
    for name, shapes in moves.items():
        if name.startswith("leaves_"):
            peak = shapes[1].ravel()[np.abs(shapes[1]).argmax()]
            turns.append(np.angle(peak) % np.pi)
    assert np.std(turns) > 0.5
    assert len(np.unique(np.round(turns, 6))) == len(turns)


def test_limbs_hardly_slip_where_they_leave_the_trunk(parts, moves):
    spatial = pytest.importorskip("scipy.spatial")
    tree = spatial.cKDTree(parts["trunk"].mesh.vertices)
    for name, part in parts.items():
        if name.startswith("leaves_"):
            near, _ = tree.query(part.mesh.vertices)
            assert np.abs(moves[name][1, near.argmin()]).max() < 0.001, name


def test_a_leaf_is_a_closed_shell_with_its_upper_face_up():
    mesh = leaf.blades(np.tile(np.eye(4), (1, 1, 1)), some_leaves(1), 9)
    assert 0 < volume(mesh) < 0.14 * 0.06 * 0.003
    _, same = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    t = same.reshape(-1)[mesh.triangles].astype(np.int64)
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    forth, back = (np.sort(edges @ k) for k in ([len(same), 1], [1, len(same)]))
    assert len(np.setxor1d(forth, back)) == 0
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    up = np.cross(b - a, c - a)[:, 2]
    upper = mesh.uv[:, :, 1].max(1) < 1 / 9  # band 0 is the upper face, band 1 the lower
    assert upper.sum() * 2 == len(upper)
    assert (up[upper] > 0).all()
    assert (up[~upper] < 0).all()


def test_leaves_stay_in_their_strips_and_follow_their_frames():
    frames = np.tile(np.eye(4), (3, 1, 1))
    frames[:, 0, 3] = 0.0, 1.0, 2.0
    mesh = leaf.blades(frames, some_leaves(3), 9)
    each = len(mesh.vertices) // 3
    np.testing.assert_allclose(
        mesh.vertices[each : 2 * each], mesh.vertices[:each] + [1.0, 0.0, 0.0], atol=1e-12
    )
    strips = np.floor(mesh.uv[..., 1] * 9)
    assert (strips == strips[:, :1]).all()  # no triangle reaches into another strip
    assert set(strips.ravel()) == set(range(6))


def test_stalks_are_tubes_that_face_outwards():
    path = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 5)[None]
    mesh = leaf.stalks(path, np.full((1, 5), 0.1), 12)
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    middle = (a + b + c) / 3.0
    assert ((np.cross(b - a, c - a) * middle * [1, 1, 0]).sum(1) > 0).all()
    np.testing.assert_allclose(np.hypot(*mesh.vertices[:, :2].T), 0.1)


def test_pebbles_are_closed_stones():
    rng = np.random.default_rng(1)
    mesh = pebbles.pebbles(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.1, 0.2]), rng)
    small = mesh.vertices[: len(mesh.vertices) // 2]
    assert 0.08 < np.linalg.norm(small, axis=1).max() <= 0.1 + 1e-9
    assert volume(mesh) > 0


def test_a_limb_droops_below_its_heading():
    rng = np.random.default_rng(2)
    limb = growth.drooping(np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.5, 0.4, (0.01, 0.002), rng, wander=0.0)
    assert limb.path[-1, 2] == pytest.approx(-0.2)
    point, along, radius = limb.at(0.5)
    assert 0.2 < point[0] < 0.3
    assert along[2] < 0
    assert 0.002 < radius < 0.01


def test_the_midrib_is_lighter_than_the_blade():
    image, _ = foliage.blade(64, 128, (0.1, 0.3, 0.1), (0.5, 0.6, 0.3), np.random.default_rng(3))
    assert image[31:33].mean() > 1.5 * image[8:20].mean()
