"""The built-in drums: its parts, its place in the picture, and that only what should move does."""

import numpy as np
import pytest

from dataset_gen.meshes import triangle_areas
from dataset_gen.scenes import SCENES
from dataset_gen.scenes import drums as module
from dataset_gen.settings import motion_file
from dataset_gen.shapes import solids
from dataset_gen.vibration import Body, read_motion, solve


@pytest.fixture(scope="module")
def scene():
    return SCENES["drums"]()


@pytest.fixture(scope="module")
def parts(scene):
    return {part.name: part for part in scene.parts}


@pytest.fixture(scope="module")
def moves(scene):
    """Mode shapes [K, V, 3] by part."""
    bodies = [Body(p.name, p.mesh.vertices, p.mesh.triangles, p.follow) for p in scene.parts]
    solved = solve(read_motion(motion_file("drums")), bodies, 30.0, None, 0)
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
    for one, two in zip(scene.parts, SCENES["drums"]().parts, strict=True):
        np.testing.assert_array_equal(one.mesh.vertices, two.mesh.vertices)
        np.testing.assert_array_equal(one.mesh.uv, two.mesh.uv)
        np.testing.assert_array_equal(one.surface.colour, two.surface.colour)


CYMBALS = ("crash_left", "crash_right", "ride", "hihat_top")


def test_what_makes_it_a_drum_kit_is_there(parts):
    assert {*CYMBALS, "hihat_bottom", "bass_front", "bass_shell", "snare_head", "tom_heads"} <= set(parts)
    assert {"stands", "pedal", "seat", "sticks", "rug"} <= set(parts)


def test_closed_parts_face_outwards(parts):
    for name in (
        *CYMBALS,
        "hihat_bottom",
        "felts",
        "seat",
        "rug",
        "beater",
        "sticks",
        "bass_hoops",
        "stand_feet",
    ):
        assert solids.volume(parts[name].mesh) > 0, name


def test_the_front_head_looks_at_the_audience(parts):
    mesh = parts["bass_front"].mesh
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a).sum(0)
    front = module.PLACE[:3, 1] / np.linalg.norm(module.PLACE[:3, 1])
    assert normal @ front > 0.99 * np.linalg.norm(normal)


def test_everything_stands_on_the_rug(parts):
    rug = parts["rug"].mesh.vertices[:, 2].max()
    for name in ("stand_feet", "throne_feet", "tom_feet", "bass_feet", "snare_rubber", "pedal"):
        assert parts[name].mesh.vertices[:, 2].min() == pytest.approx(rug, abs=0.006), name
    assert parts["bass_hoops"].mesh.vertices[:, 2].min() > rug


def test_each_cymbal_rocks_about_its_own_hole_and_the_rest_stands(scene, moves):
    for k, name in enumerate(CYMBALS):
        for other, shape in moves.items():
            assert (size(shape[k]) > 0) == (other == name), other
        assert size(moves[name][k]) == pytest.approx(0.003 if name == "hihat_top" else 0.005)
    pivots = {c.name: c.pivot for c in (*module.hw.CYMBALS, module.hw.HIHAT)}
    for name, mode in zip(CYMBALS, read_motion(motion_file("drums")).modes, strict=False):
        np.testing.assert_allclose(mode.field.pivot, (module.PLACE @ [*pivots[name], 1.0])[:3], atol=1e-3)


def test_cymbals_have_phases_of_their_own():
    phases = [mode.phase for mode in read_motion(motion_file("drums")).modes[:4]]
    assert len(set(phases)) == 4


def test_the_front_head_swells_in_its_middle_and_is_held_at_its_rim(parts, moves):
    shape, mesh = moves["bass_front"][4], parts["bass_front"].mesh
    at = np.linalg.inv(module.PLACE) @ np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))]).T
    r = np.linalg.norm(at[:3].T - module.BASS_FRONT, axis=1)
    travel = np.linalg.norm(np.abs(shape), axis=1)
    assert travel[r < 0.02].min() > 0.0039
    assert travel[r > 0.3595].max() < 2e-5
    assert size(moves["bass_hoops"][4]) == 0.0
