"""The built-in balls: twelve different ones, each on its ring, and what may move."""

import numpy as np
import pytest

from dataset_gen.meshes import triangle_areas
from dataset_gen.scenes import materials
from tests.dataset_gen.builtin import open_edges, volume

SCENE = "materials"


def test_three_rows_of_four_balls_on_a_tray(parts):
    balls = {name for name in parts if name.startswith("ball_")}
    assert len(balls) == 12
    assert set(parts) - balls == {"board", "rim", "rim_bead", "feet", "rings"}
    centres = np.array(list(materials.places().values()))
    assert len(np.unique(centres[:, 0].round(6))) == 4
    assert len(np.unique(centres[:, 1].round(6))) == 3


def test_it_has_the_scale_of_the_published_scene(scene):
    points = np.concatenate([part.mesh.vertices for part in scene.parts])
    assert np.isfinite(points).all()
    assert 1.2 < np.linalg.norm(points, axis=1).max() < 1.45
    assert 60_000 <= sum(len(part.mesh.triangles) for part in scene.parts) <= 300_000


def test_every_ball_is_a_closed_sphere_that_touches_its_ring_and_nothing_else(parts):
    ring = parts["rings"].mesh.vertices
    for name, centre in materials.places().items():
        mesh = parts[f"ball_{name}"].mesh
        np.testing.assert_allclose(np.linalg.norm(mesh.vertices - centre, axis=1), materials.RADIUS)
        assert open_edges(mesh) == 0
        assert volume(mesh) == pytest.approx(4.0 / 3.0 * np.pi * materials.RADIUS**3, rel=0.01)
        assert mesh.vertices[:, 2].min() > materials.BOARD + 0.005
        gap = np.linalg.norm(ring - centre, axis=1).min() - materials.RADIUS
        assert -1e-9 < gap < 0.002
    assert materials.SPACING > 2 * materials.RADIUS + 0.05


@pytest.mark.parametrize("name", ["board", "rim", "rim_bead", "feet", "rings"])
def test_the_tray_is_closed_and_faces_outwards(parts, name):
    assert open_edges(parts[name].mesh) == 0
    assert volume(parts[name].mesh) > 1e-4


def test_an_open_body_would_be_noticed(parts):
    mesh = parts["board"].mesh
    assert open_edges(type(mesh)(mesh.vertices, mesh.triangles[1:], mesh.uv[1:])) > 0


def test_every_ball_moves_its_own_way_and_the_tray_is_still(shapes):
    tops = []
    for name, shape in shapes.items():
        if name.startswith("ball_"):
            largest = np.argmax(np.abs(shape).sum(1))
            assert np.abs(shape).max() > 0.002
            tops.append(shape[largest])
        else:
            np.testing.assert_array_equal(shape, 0.0)
    gaps = [np.abs(a - b).max() for i, a in enumerate(tops) for b in tops[:i]]
    assert min(gaps) > 1e-4


def test_balls_hardly_slide_on_their_rings(parts, shapes):
    for name in materials.places():
        low = parts[f"ball_{name}"].mesh.vertices[:, 2] < materials.BALL_Z - 0.9 * materials.RADIUS
        assert low.sum() > 50
        assert np.abs(shapes[f"ball_{name}"][low]).max() < 0.03 * 0.005


def test_meshes_and_textures_are_sound_and_no_two_balls_look_alike(scene):
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
    looks = [p.surface.colour for p in scene.parts if p.name.startswith("ball_")]
    assert min(np.abs(a - b).mean() for i, a in enumerate(looks) for b in looks[:i]) > 0.05
