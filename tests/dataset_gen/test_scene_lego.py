"""The built-in lego: its parts, its place in the picture, and that only what should move does."""

import numpy as np
import pytest

from dataset_gen.meshes import triangle_areas
from dataset_gen.scenes import SCENES
from dataset_gen.scenes import lego as module
from dataset_gen.settings import motion_file
from dataset_gen.shapes import solids
from dataset_gen.vibration import Body, read_motion, solve


@pytest.fixture(scope="module")
def scene():
    return SCENES["lego"]()


@pytest.fixture(scope="module")
def parts(scene):
    return {part.name: part for part in scene.parts}


@pytest.fixture(scope="module")
def moves(scene):
    """Mode shapes [K, V, 3] by part."""
    bodies = [Body(p.name, p.mesh.vertices, p.mesh.triangles, p.follow) for p in scene.parts]
    solved = solve(read_motion(motion_file("lego")), bodies, 30.0, None, 0)
    return dict(zip((p.name for p in scene.parts), solved.shapes, strict=True))


def size(shape):
    return float(np.linalg.norm(np.abs(shape), axis=-1).max())


def test_it_fits_the_picture_and_the_budget(scene):
    points = np.concatenate([part.mesh.vertices for part in scene.parts])
    assert np.isfinite(points).all()
    assert np.linalg.norm(points, axis=1).max() < 1.45
    assert np.abs(points).max() > 1.0
    assert 60_000 <= sum(len(part.mesh.triangles) for part in scene.parts) <= 300_000
    assert len({part.name for part in scene.parts}) == len(scene.parts)


def test_meshes_and_maps_are_sound(scene):
    for part in scene.parts:
        mesh, surface = part.mesh, part.surface
        assert mesh.triangles.min() >= 0
        assert mesh.triangles.max() < len(mesh.vertices)
        assert mesh.uv.shape == (*mesh.triangles.shape, 2)
        assert np.isfinite(mesh.uv).all()
        assert triangle_areas(mesh.vertices, mesh.triangles).min() > 0
        assert part.follow.shape == (len(mesh.vertices),)
        for image in (surface.colour, surface.relief, np.asarray(surface.roughness)):
            if image is not None:
                assert image.min() >= 0
                assert image.max() <= 1


def test_every_surface_carries_texture(scene):
    """Motion shows only where brightness changes along the surface."""
    for part in scene.parts:
        assert part.surface.colour.mean(2).std() > 0.008, part.name


def test_no_two_triangles_coincide(scene):
    corners = np.concatenate(
        [np.sort(p.mesh.vertices[p.mesh.triangles].round(5), axis=1) for p in scene.parts]
    )
    centres = np.concatenate([p.mesh.vertices[p.mesh.triangles].mean(1) for p in scene.parts]).round(5)
    keys = np.concatenate([centres, corners.reshape(len(corners), -1)], axis=1)
    assert len(np.unique(keys, axis=0)) == len(keys)


def test_it_is_the_same_each_time(scene):
    for one, two in zip(scene.parts, SCENES["lego"]().parts, strict=True):
        np.testing.assert_array_equal(one.mesh.vertices, two.mesh.vertices)
        np.testing.assert_array_equal(one.mesh.uv, two.mesh.uv)
        np.testing.assert_array_equal(one.surface.colour, two.surface.colour)


MOVING = {"blade", "blade_studs", "blade_pins", "stripes", "teeth", "arms", "pistons", "rods"}


def test_what_makes_it_a_bulldozer_is_there(parts):
    assert set(parts) >= MOVING
    assert {"base", "base_studs", "tracks", "wheels", "engine", "cab", "seat", "chrome", "claws"} <= set(
        parts
    )


def test_closed_parts_face_outwards(parts):
    for name in ("base", "tracks", "wheels", "blade", "teeth", "seat", "claws", "axles", "pistons", "engine"):
        assert solids.volume(parts[name].mesh) > 0, name


def test_studs_stand_on_their_bricks(parts):
    for name in ("base", "cab", "fender", "body"):
        bricks, studs = parts[name].mesh.vertices, parts[f"{name}_studs"].mesh.vertices
        assert studs[:, 2].max() > bricks[:, 2].max()


def test_the_treads_stand_on_the_baseplates_studs(parts):
    tops = parts["base_studs"].mesh.vertices[:, 2].max()
    assert parts["tracks"].mesh.vertices[:, 2].min() == pytest.approx(tops, abs=0.03 * module.PITCH)


def test_blade_and_arms_rock_and_the_rest_of_the_bulldozer_is_still(moves):
    assert size(moves["teeth"][0]) > size(moves["blade"][0]) > 0.004
    assert max(size(shape[0]) for shape in moves.values()) == pytest.approx(0.005)
    for name, shape in moves.items():
        assert (size(shape[0]) > 0) == (name in MOVING), name


def test_the_arms_turn_about_their_hinge(parts, moves):
    hinge = (module.place() @ [*module.gear.HINGE, 1.0])[:3]
    across = module.place()[:3, 1] / module.PITCH
    offset = parts["arms"].mesh.vertices - hinge
    lever = np.linalg.norm(offset - (offset @ across)[:, None] * across, axis=1)
    travel = np.linalg.norm(np.abs(moves["arms"][0]), axis=1)
    np.testing.assert_allclose(travel / lever, np.median(travel / lever), rtol=0.02)


def test_pistons_hang_between_bonnet_and_blade(parts, moves):
    follow = np.concatenate([parts["pistons"].follow, parts["rods"].follow])
    assert follow.min() == 0.0
    assert follow.max() == 1.0
    assert size(moves["rods"][0]) > 1.8 * size(moves["pistons"][0])


def test_the_cab_trembles_on_its_posts_and_its_feet_do_not(parts, moves):
    assert size(moves["cab"][1]) > 0.001
    feet = parts["cab"].mesh.vertices[:, 2] < -0.0201
    np.testing.assert_array_equal(moves["cab"][1][feet], 0.0)
    for name, shape in moves.items():
        assert (size(shape[1]) > 0) == (name.startswith("cab") or name == "beacon"), name
