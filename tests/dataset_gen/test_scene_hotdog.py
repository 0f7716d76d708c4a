"""The built-in hot dogs: parts, closed bodies, contacts, and what may move."""

import numpy as np
import pytest

from dataset_gen.scenes import hotdog
from tests.dataset_gen.builtin import open_edges, volume

SCENE = "hotdog"


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
