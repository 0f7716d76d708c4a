"""The built-in lego: its parts, its place in the picture, and that only what should move does."""

import numpy as np
import pytest

from dataset_gen.scenes import lego as module
from dataset_gen.shapes import solids
from tests.dataset_gen.builtin import size

SCENE = "lego"


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
