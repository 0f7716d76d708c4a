"""The built-in microphone: what moves, what does not, and that parts stay together."""

import numpy as np
import pytest

SCENE = "mic"


def test_it_has_the_scale_of_the_published_scene(scene):
    points = np.concatenate([part.mesh.vertices for part in scene.parts])
    assert (np.abs(points).max(0) < 1.3).all()
    assert np.abs(points).max() > 0.9


def test_tripod_and_lying_cable_are_exactly_still(scene, shapes):
    for name in ("hub", "legs", "feet"):
        np.testing.assert_array_equal(shapes[name], 0.0)
    cable = next(part for part in scene.parts if part.name == "cable")
    lying = cable.mesh.vertices[:, 2] < -0.82
    assert lying.sum() > 500
    np.testing.assert_array_equal(shapes["cable"][lying], 0.0)


def test_the_microphone_moves_and_its_front_moves_most(shapes):
    size = {name: np.linalg.norm(np.abs(shape), axis=1).max() for name, shape in shapes.items()}
    assert max(size.values()) == pytest.approx(0.005)
    assert size["collar"] > size["body"] > size["rod"] > 0.0005


def test_neighbouring_vertices_move_alike_across_all_parts(scene, shapes):
    points = np.concatenate([part.mesh.vertices for part in scene.parts])
    moves = np.concatenate([shapes[part.name].imag for part in scene.parts])
    spatial = pytest.importorskip("scipy.spatial")
    pairs = spatial.cKDTree(points).query_pairs(0.02, output_type="ndarray")
    owner = np.repeat(np.arange(len(scene.parts)), [len(part.mesh.vertices) for part in scene.parts])
    assert (owner[pairs[:, 0]] != owner[pairs[:, 1]]).sum() > 100  # parts do touch
    jump = np.linalg.norm(moves[pairs[:, 0]] - moves[pairs[:, 1]], axis=1)
    assert jump.max() < 0.02 * 0.005  # 2 % of the amplitude over 0.02 units


def test_the_mode_is_a_sine(shapes):
    for shape in shapes.values():
        np.testing.assert_array_equal(shape.real, 0.0)
